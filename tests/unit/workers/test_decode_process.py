"""Decoding apart: the same pixels as in place, limits that the kernel keeps, and a process that may die."""

import io
import os
import signal
import threading
from collections.abc import Iterator
from datetime import UTC, datetime

import cv2
import numpy as np
import pytest
import trimesh
from astropy.io import fits

from service.errors import ImageError, MeshFileError, TooLargeError, UnsupportedMediaTypeError
from service.imaging.limits import ImageLimits
from service.workers.decode_process import DecodeProcess
from service.workers.decoding import InPlace
from service.workers.limits import DecodeLimits

NOISE = np.random.default_rng(0).integers(0, 4000, (40, 50), dtype=np.uint16)
PNG = cv2.imencode(".png", NOISE)[1].tobytes()
BOX = trimesh.Scene(trimesh.creation.box((1, 2, 3))).export(file_type="glb")


def fits_file(data: np.ndarray) -> bytes:
    stream = io.BytesIO()
    fits.PrimaryHDU(data, fits.Header({"DATE-AVG": "2026-11-20T03:04:05.5"})).writeto(stream)
    return stream.getvalue()


def npy(array: np.ndarray) -> bytes:
    stream = io.BytesIO()
    np.save(stream, array)
    return stream.getvalue()


@pytest.fixture(scope="module")
def decoder() -> Iterator[DecodeProcess]:
    decoder = DecodeProcess(DecodeLimits(memory_bytes=512 << 20, cpu_s=1, image=ImageLimits(pixels=1 << 27)))
    yield decoder
    decoder.close()


FILES = {
    "image/png": PNG,
    "image/jpeg": cv2.imencode(".jpg", np.dstack([NOISE.astype(np.uint8)] * 3))[1].tobytes(),
    "image/fits": fits_file(NOISE),
    "application/x-npy": npy(np.stack([NOISE] * 3)),
}


@pytest.mark.parametrize("media_type", FILES)
def test_the_same_as_in_place(decoder, media_type):
    body = FILES[media_type]
    here, apart = (each.frames(body, media_type) for each in (InPlace(), decoder))
    assert len(here) == len(apart)
    for one, other in zip(here, apart, strict=True):
        assert (one.bits, one.channels, one.facts) == (other.bits, other.channels, other.facts)
        assert one.image.dtype == other.image.dtype
        np.testing.assert_array_equal(one.image, other.image)
    assert decoder.split(body, media_type) == InPlace().split(body, media_type)
    assert decoder.count(body, media_type) == len(here)


def test_facts_and_meshes_come_across(decoder):
    assert decoder.facts(FILES["image/fits"], "image/fits").time == datetime(2026, 11, 20, 3, 4, 5, 500_000, UTC)
    (here,), (apart,) = InPlace().parts(BOX, "glb"), decoder.parts(BOX, "glb")
    assert here.name == apart.name
    np.testing.assert_array_equal(here.vertices, apart.vertices)
    np.testing.assert_array_equal(here.faces, apart.faces)


def test_refusals_come_across_as_they_are(decoder):
    with pytest.raises(UnsupportedMediaTypeError) as refused:
        decoder.frame(PNG, "text/plain")
    assert refused.value.field == "header:Content-Type"
    assert "image/png" in refused.value.facts["supported"]
    with pytest.raises(ImageError, match="cut short"):
        decoder.frame(PNG[:-9], "image/png")
    with pytest.raises(MeshFileError, match="magic"):
        decoder.parts(b"junk", "glb")
    assert decoder.losses == 0


def test_memory_is_limited_and_the_next_file_is_decoded(decoder):
    body = cv2.imencode(".png", np.zeros((8192, 8192), np.uint8))[1].tobytes()
    deep = npy(np.zeros((1, 1), np.float64)).replace(b"(1, 1)", b"(6000, 6000)")[:128] + bytes(6000 * 6000 * 8)
    with pytest.raises(TooLargeError) as refused:
        decoder.frame(deep, "application/x-npy")
    assert refused.value.facts["setting"] == "SKYPOSE_DECODE_MEMORY_MB"
    assert decoder.frame(body, "image/png").image.shape == (8192, 8192)


def test_time_is_limited_and_the_next_file_is_decoded(decoder):
    empty = b"XTENSION= 'IMAGE   '           ".ljust(80) + b"BITPIX  =                    8".ljust(80)
    empty += b"NAXIS   =                    0".ljust(80) + b"PCOUNT  = 0".ljust(80) + b"GCOUNT  = 1".ljust(80)
    slow = fits_file(np.zeros(0))[:2880] + (empty + b"END").ljust(2880) * 24000
    with pytest.raises(TooLargeError) as refused:
        decoder.frame(slow, "image/fits")
    assert (refused.value.facts["setting"], refused.value.field) == ("SKYPOSE_DECODE_CPU_S", "body")
    np.testing.assert_array_equal(decoder.frame(PNG, "image/png").image, NOISE)


def test_a_process_that_stands_still_is_replaced():
    decoder = DecodeProcess(DecodeLimits(timeout_s=0.5))
    try:
        decoder.frame(PNG, "image/png")
        os.kill(decoder.pid, signal.SIGSTOP)
        with pytest.raises(TooLargeError) as refused:
            decoder.frame(PNG, "image/png")
        assert refused.value.facts["setting"] == "SKYPOSE_DECODE_TIMEOUT_S"
        assert decoder.frame(PNG, "image/png").bits == 16
    finally:
        decoder.close()


def test_a_death_that_is_not_the_files_fault_costs_a_retry(decoder):
    decoder.frame(PNG, "image/png")
    first, losses = decoder.pid, decoder.losses
    os.kill(first, signal.SIGSTOP)  # so that it is in the middle of the job when it dies
    threading.Timer(0.2, os.kill, (first, signal.SIGKILL)).start()
    assert decoder.frame(PNG, "image/png").bits == 16
    assert (decoder.losses, decoder.pid != first) == (losses + 1, True)
    for _ in range(3):  # also while it starts
        os.kill(decoder.pid, signal.SIGKILL)
        decoder.prestart()
    assert decoder.frame(PNG, "image/png").bits == 16


def test_a_file_that_kills_the_decoder_is_refused(decoder, monkeypatch):
    attempt = decoder._attempt

    def killing(method, message, body):
        os.kill(decoder._ready().process.pid, signal.SIGSEGV)
        return attempt(method, message, body)

    monkeypatch.setattr(decoder, "_attempt", killing)
    with pytest.raises(ImageError, match="the decoder ended on it"):
        decoder.frame(PNG, "image/png")
    with pytest.raises(MeshFileError, match="the decoder ended on it"):
        decoder.parts(BOX, "glb")
    monkeypatch.undo()
    assert decoder.frame(PNG, "image/png").bits == 16


def test_it_knows_nothing_of_its_parents_environment(monkeypatch):
    monkeypatch.setenv("SKYPOSE_SECRET", "x")
    decoder = DecodeProcess()
    try:
        decoder.frame(PNG, "image/png")
        with open(f"/proc/{decoder.pid}/environ", "rb") as environment:  # noqa: PTH123 -- not a file to keep
            assert b"SKYPOSE" not in environment.read()
    finally:
        decoder.close()

"""Limits of files: each is named by its setting, before anything is decoded; each setting exists and is obeyed."""

import dataclasses
import struct

import cv2
import numpy as np
import pytest
import trimesh

from gpu.mesh_limits import MeshLimits
from service.errors import ImageError, TooLargeError
from service.imaging.limits import ImageLimits
from service.imaging.split import frame_count
from service.settings import Settings
from service.workers import decoding
from service.workers.decoding import InPlace
from service.workers.limits import DecodeLimits
from tests.fuzz.seeds import fits_files, grey, ser

SMALL = ImageLimits(pixels=1000, frames=2, ratio=3, header_bytes=5760)


def refused(limits: DecodeLimits, body: bytes, kind: str, *, mesh: bool = False) -> str:
    with pytest.raises(TooLargeError) as error:
        InPlace(limits).parts(body, kind) if mesh else InPlace(limits).frames(body, kind)
    facts = error.value.facts
    assert facts["found"] > facts["limit"]
    return facts["setting"]


def png(height: int, width: int) -> bytes:
    return cv2.imencode(".png", np.zeros((height, width), np.uint8))[1].tobytes()


def test_each_limit_of_images_is_named():
    small = DecodeLimits(image=SMALL)
    assert refused(small, png(50, 50), "image/png") == "SKYPOSE_MAX_IMAGE_PIXELS"
    assert refused(small, ser(grey(16, 3)), "video/x-ser") == "SKYPOSE_MAX_IMAGE_FRAMES"
    many = cv2.imencodemulti(".tiff", list(grey(16, 3)))[1].tobytes()
    assert refused(small, many, "image/tiff") == "SKYPOSE_MAX_IMAGE_FRAMES"
    cards = b"".join(f"COMMENT {n}".ljust(80).encode() for n in range(200))
    body = fits_files()[0]
    assert refused(small, body[:80] + cards + body[80:], "image/fits") == "SKYPOSE_MAX_HEADER_KB"
    bomb = DecodeLimits(image=ImageLimits(pixels=1 << 28))
    assert refused(bomb, png(9000, 9000), "image/png") == "SKYPOSE_MAX_IMAGE_RATIO"


def test_a_claim_of_many_frames_costs_nothing():
    claim = struct.pack("<14s7i40s40s40s2q", b"LUCAM-RECORDER", 0, 0, 0, 0, 0, 16, 2**31 - 1, b"", b"", b"", 0, 0)
    with pytest.raises(ImageError):
        frame_count(claim, "video/x-ser")


def test_directories_of_a_tiff_cannot_share_their_values_for_ever():
    first = cv2.imencode(".tiff", grey(8)[0])[1].tobytes()
    offset = struct.unpack_from("<I", first, 4)[0]
    entries = struct.unpack_from("<H", first, offset)[0]
    directory = first[offset : offset + 2 + 12 * entries]
    shared = bytearray(first)
    for _ in range(300):  # each refers to the same pixels and values
        struct.pack_into("<I", shared, len(shared) - 4, len(shared))
        shared += directory + b"\0\0\0\0"
    with pytest.raises((ImageError, TooLargeError)):
        InPlace(DecodeLimits(image=ImageLimits(frames=100))).frames(bytes(shared), "image/tiff")


@pytest.mark.parametrize(
    ("limit", "kinds"),
    [
        ("faces", ("glb", "obj", "stl", "ply")),
        ("vertices", ("glb", "obj", "ply")),
        ("nodes", ("glb",)),
        ("parts", ("glb",)),
    ],
)
def test_each_limit_of_meshes_is_named(limit, kinds):
    box = trimesh.creation.box((1, 2, 3))
    for kind in kinds:
        data = trimesh.Scene([box, box.copy()]).export(file_type="glb") if kind == "glb" else box.export(file_type=kind)
        body = data.encode() if isinstance(data, str) else data
        limits = DecodeLimits(mesh=dataclasses.replace(MeshLimits(), **{limit: 1}))
        assert refused(limits, body, kind, mesh=True) == f"SKYPOSE_MAX_MODEL_{limit.upper()}"


def test_every_limit_has_a_setting_that_counts():
    settings = Settings().model_dump()
    assert DecodeLimits.of(settings) == DecodeLimits()
    names = {f"SKYPOSE_{name.upper()}" for name in settings}
    assert set(decoding._MESH_SETTINGS.values()) <= names
    assert set(decoding._MESH_SETTINGS) == {field.name for field in dataclasses.fields(MeshLimits)}
    changed = DecodeLimits.of({**settings, "max_image_pixels": 7, "max_model_depth": 3, "decode_cpu_s": 2})
    assert (changed.image.pixels, changed.mesh.depth, changed.cpu_s) == (7, 3, 2)


def test_a_fits_file_that_claims_more_than_it_has_is_cut_short():
    body = fits_files()[0].replace(b"NAXIS1  =                   32", b"NAXIS1  =                 3200")
    with pytest.raises(ImageError, match="cut short"):
        InPlace().frames(body, "image/fits")

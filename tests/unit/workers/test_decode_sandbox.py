"""A decode process that a file took over: what it can still do, with Landlock and without, and when it ends."""

import io
import os
import select
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np
import pytest
import trimesh
from astropy.io import fits
from taken_over import ATTACKS

import service
from service.errors import WorkerFailedError
from service.workers import decode_process, guarded
from service.workers.decode_process import DecodeProcess
from service.workers.limits import DecodeLimits
from service.workers.sandbox import Sandbox, code_paths

START = "import sys; from service.workers.kernel import die_with; die_with(int(sys.argv[2])); "
GONE_S = 20.0


def started(with_landlock: bool, limits: DecodeLimits | None = None) -> DecodeProcess:
    decoder = DecodeProcess(limits)
    with pytest.MonkeyPatch.context() as patch:
        code = f"from taken_over import main; main(int(sys.argv[1]), {with_landlock})"
        patch.setattr(decode_process, "_START", START + code)
        decoder.prestart()
    return decoder


@pytest.fixture(scope="module", params=[True, False], ids=["landlock", "no-landlock"])
def decoder(request) -> Iterator[DecodeProcess]:
    decoder = started(request.param)
    yield decoder
    decoder.close()


@pytest.fixture
def database(tmp_path) -> Path:
    path = tmp_path / "skypose.sqlite3"
    path.write_bytes(b"SQLite format 3")
    return path


@pytest.mark.parametrize("name", [name for name in ATTACKS if name != "start_thread"])
def test_an_intruder_is_refused(decoder, database, name):
    target = database.parent if name == "list_folder" else database
    assert decoder._call("attack", b"", name, str(target)).value in ("EACCES", "EPERM")
    assert [*database.parent.iterdir()] == [database]


def test_threads_are_not(decoder):
    assert decoder._call("attack", b"", "start_thread", "").value is None


def test_what_holds_is_said(decoder):
    holds = ("dies with its parent", "no core dumps", "no capabilities", "no new privileges", "seccomp")
    assert set(holds) <= set(decoder.sandbox.in_force)
    without = "Landlock" in decoder.sandbox.missing
    assert without != ("Landlock" in decoder.sandbox.in_force)
    assert ("NOT in force: Landlock (none in this kernel)" in str(decoder.sandbox)) == without
    assert str(Sandbox()) == "off (SKYPOSE_DECODE_SANDBOX)"


def files() -> Iterator[tuple[str, bytes]]:
    image = np.random.default_rng(0).integers(0, 255, (48, 64), dtype=np.uint8)
    for end, kind in (("png", "image/png"), ("jpg", "image/jpeg"), ("tiff", "image/tiff")):
        yield kind, cv2.imencode(f".{end}", image)[1].tobytes()
    for hdu in (fits.PrimaryHDU(image), fits.CompImageHDU(image, compression_type="RICE_1")):
        hdu.header["CTYPE1"], hdu.header["CTYPE2"] = "RA---TAN", "DEC--TAN"  # solved: read with its own library
        stream = io.BytesIO()
        hdu.writeto(stream)
        yield "image/fits", stream.getvalue()


def test_images_and_meshes_are_decoded_in_it(decoder):
    for kind, body in files():
        assert decoder.frame(body, kind).image.shape == (48, 64)
        decoder.facts(body, kind)
    box = trimesh.creation.box((1, 2, 3))
    for kind in ("glb", "obj", "stl", "ply"):
        data = trimesh.Scene(box).export(file_type=kind)
        assert decoder.parts(data if isinstance(data, bytes) else data.encode(), kind)
    assert decoder.losses == 0


@pytest.mark.parametrize(("name", "codec"), [("a.avi", "FFV1"), ("a.mp4", "mp4v"), ("a.mkv", "FFV1")])
def test_video_is_decoded_in_it(decoder, tmp_path, name, codec):
    writer = cv2.VideoWriter(str(tmp_path / name), cv2.VideoWriter.fourcc(*codec), 25, (64, 48))
    for level in (20, 90, 160):
        writer.write(np.full((48, 64, 3), level, np.uint8))
    writer.release()
    assert len(decoder.frames((tmp_path / name).read_bytes(), "video/mp4")) == 3
    assert decoder.losses == 0


def test_a_measure_that_is_required_and_missing_is_an_error():
    decoder = started(False, DecodeLimits(sandbox="required"))
    with pytest.raises(WorkerFailedError, match=r"SKYPOSE_DECODE_SANDBOX.*NOT in force: Landlock"):
        decoder.frame(b"", "image/png")
    assert decoder.pid is None


def test_it_can_be_switched_off(database):
    decoder = started(True, DecodeLimits(sandbox="off"))
    try:
        assert decoder._call("attack", b"", "read_file", str(database)).value is None
        assert decoder.sandbox == Sandbox()
    finally:
        decoder.close()


def test_what_lies_beside_the_packages_is_not_readable():
    assert Path(service.__file__).parents[1] not in code_paths()


def test_who_stands_still_ends_with_the_parent():
    command = [sys.executable, str(Path(__file__).with_name("taken_over.py"))]
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, env=environment) as parent:
        assert parent.stdout is not None
        parent.stdout.readline()
        children = [int(parent.stdout.readline()) for _ in ("decoder", "worker")]
        handles = [os.pidfd_open(pid) for pid in children]
        for pid in children:
            os.kill(pid, signal.SIGSTOP)
        parent.kill()
    ended = [select.select([handle], [], [], GONE_S)[0] == [handle] for handle in handles]
    for handle in handles:
        os.close(handle)
    assert ended == [True, True]


def test_it_does_not_begin_without_its_parent():
    lone = subprocess.run(
        [sys.executable, "-c", START + "print('here')", "0", "1"], stdout=subprocess.PIPE, check=False
    )
    assert (lone.returncode, lone.stdout) == (1, b"")


@pytest.mark.parametrize(("sandbox", "dumpable"), [("auto", False), ("off", True)])
def test_a_worker_hides_its_memory(monkeypatch, sandbox, dumpable):
    """Its own: what it would do is noted, or this process could not be looked into any more."""
    hidden = []
    monkeypatch.setattr(guarded, "hide", lambda: hidden.append(True))
    monkeypatch.setattr(guarded, "build_kernels", lambda *_: None)
    guarded.guarded(DecodeLimits(sandbox=sandbox)).close()
    assert hidden == [] if dumpable else [True]


def test_hidden_memory_is_not_dumped():
    code = "import ctypes; from service.workers.kernel import hide; hide(); print(ctypes.CDLL(None).prctl(3))"
    said = subprocess.run([sys.executable, "-c", code], stdout=subprocess.PIPE, check=True)
    assert said.stdout == b"0\n"

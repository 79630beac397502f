"""Files as other programs write them, through a running service with the real tracker, and what comes back."""

import csv
import gzip
import io
import json
import struct
from collections.abc import Callable, Iterator

import cv2
import numpy as np
import pytest
import trimesh
from astropy import units
from astropy.io import fits
from astropy.time import Time
from astropy.wcs import WCS
from brahe.ccsds import AEM, APM
from passes import box_pass, comparable
from server_process import Server

from service.client import Client

SIZE = 48
GIVEN = box_pass(2, SIZE)
SMALL = {"filter": {"particles": 100, "seed": 5}, "light": {"sun": [0.0, 0.0, -1.0]}}
OUTLINED = {"filter": {"preset": "paper", "particles": 400, "seed": 5}}  # a flat box: its light is no body's
TIME = "2026-11-20T03:04:05.500"


def pixels(body: bytes) -> np.ndarray:
    return cv2.imdecode(np.frombuffer(body, np.uint8), cv2.IMREAD_UNCHANGED)


FRAMES = [pixels(body) for body in GIVEN.frames]
SKY = pixels(GIVEN.background[0])


def deep(image: np.ndarray) -> np.ndarray:
    return image.astype(np.uint16) * 200


def encoded(suffix: str) -> Callable[[np.ndarray], bytes]:
    return lambda image: cv2.imencode(suffix, image)[1].tobytes()


def fits_file(kind=fits.PrimaryHDU, **options) -> Callable[[np.ndarray], bytes]:
    def write(image: np.ndarray) -> bytes:
        hdu = kind(image[::-1], **options)  # FITS counts rows from the bottom
        hdu.header["DATE-OBS"], hdu.header["EXPTIME"] = "2026-11-20T03:04:05", 1.0
        file = io.BytesIO()
        fits.HDUList([hdu] if kind is fits.PrimaryHDU else [fits.PrimaryHDU(), hdu]).writeto(file)
        return file.getvalue()

    return write


def npy(image: np.ndarray) -> bytes:
    file = io.BytesIO()
    np.save(file, image)
    return file.getvalue()


def imagebytes(image: np.ndarray) -> bytes:
    kind = 6 if image.dtype == np.uint8 else 8
    head = struct.pack("<11i", 1, 0, 1, 1, 44, 2, kind, 2, image.shape[1], image.shape[0], 0)
    return head + image.T.tobytes()


def ser(image: np.ndarray) -> bytes:
    depth = 8 * image.itemsize
    text = [b"camera", b"", b"scope"]
    head = struct.pack("<14s7i40s40s40s2q", b"LUCAM-RECORDER", 0, 0, 0, SIZE, SIZE, depth, 1, *text, 0, 0)
    return head + image.tobytes()


FORMATS = {
    "png8": ("image/png", encoded(".png"), False),
    "tiff8": ("image/tiff", encoded(".tiff"), False),
    "fits8": ("image/fits", fits_file(), False),
    "npy8": ("application/x-npy", npy, False),
    "ser8": ("video/x-ser", ser, False),
    "imagebytes8": ("application/imagebytes", imagebytes, False),
    "png16": ("image/png", encoded(".png"), True),
    "tiff16": ("image/tiff", encoded(".tiff"), True),
    "fits16": ("image/fits", fits_file(), True),
    "fits16 gzip": ("image/fits", lambda image: gzip.compress(fits_file()(image)), True),
    "fits16 rice": ("image/fits", fits_file(fits.CompImageHDU, compression_type="RICE_1"), True),
    "npy16": ("application/x-npy", npy, True),
    "imagebytes16": ("application/imagebytes", imagebytes, True),
}


@pytest.fixture(scope="module")
def client(tmp_path_factory) -> Iterator[Client]:
    server = Server(tmp_path_factory.mktemp("formats") / "data")
    server.start()
    with Client(server.url) as client:
        yield client
    server.stop()


@pytest.fixture(scope="module")
def model_id(client) -> str:
    return client.upload_model(GIVEN.mesh, file_name="box.stl").model_id


def tracked(client: Client, model_id: str, media: str, write, is_deep: bool) -> dict:
    session = client.create_session(model_id, **SMALL).session_id
    form = deep if is_deep else (lambda image: image)
    client.add_background(session, write(form(SKY)), media)
    return client.post_frame(session, write(form(FRAMES[0])), media).model_dump(mode="json")


@pytest.fixture(scope="module")
def references(client, model_id) -> dict[bool, dict]:
    """The answer to the same pixels as PNG, with 8 and 16 bits."""
    return {is_deep: tracked(client, model_id, "image/png", encoded(".png"), is_deep) for is_deep in (False, True)}


@pytest.mark.parametrize("name", FORMATS)
def test_the_same_pixels_have_the_same_answer(client, model_id, references, name):
    media, write, is_deep = FORMATS[name]
    found = tracked(client, model_id, media, write, is_deep)
    told = {"assumed": None}  # a FITS file brings its time
    assert comparable(found) | told == comparable(references[is_deep]) | told
    if name.startswith("fits"):
        assert found["time"] == f"{TIME}Z"


def test_lossy_files_are_tracked_like_the_lossless(client, model_id, references, tmp_path):
    video = tmp_path / "pass.avi"
    writer = cv2.VideoWriter(str(video), cv2.VideoWriter_fourcc(*"MJPG"), 10.0, (SIZE, SIZE))
    for image in FRAMES:
        writer.write(cv2.cvtColor(image, cv2.COLOR_GRAY2BGR))
    writer.release()
    session = client.create_session(model_id, **SMALL, likelihood={"feature": "intensity"}).session_id
    client.add_background(
        session, cv2.imencode(".png", cv2.cvtColor(SKY, cv2.COLOR_GRAY2BGR))[1].tobytes(), "image/png"
    )
    told = list(client.track_file(session, video))
    jpeg = tracked(client, model_id, "image/jpeg", encoded(".jpg"), False)
    for best in (told[0].best.model_dump(), jpeg["best"]):
        for place in ("x_px", "y_px"):
            assert best[place] == pytest.approx(references[False]["best"][place], abs=1.5)
    assert [item.index for item in told] == [0, 1]


def test_meshes_of_trimesh_are_the_same_body(client, tmp_path):
    box = trimesh.creation.box((2.0, 1.2, 0.6))
    sizes = {}
    for suffix in ("stl", "obj", "ply", "glb"):
        path = tmp_path / f"box.{suffix}"
        box.export(path)
        model = client.upload_model(path)
        sizes[suffix] = (model.faces, model.watertight, *np.round(model.size, 5), len(model.symmetries))
    robot = '<robot name="box"><link name="body"><visual><geometry><mesh filename="package://a/box.stl"/></geometry></visual></link></robot>'
    (tmp_path / "box.urdf").write_text(robot)
    model = client.upload_model(tmp_path / "box.urdf")
    sizes["urdf"] = (model.faces, model.watertight, *np.round(model.size, 5), len(model.symmetries))
    assert len(set(sizes.values())) == 1, sizes


@pytest.fixture(scope="module")
def history(client, model_id) -> str:
    """A pass of solved FITS frames: pointing and time out of the files."""
    wcs = WCS(naxis=2)
    wcs.wcs.ctype, wcs.wcs.crval = ["RA---TAN", "DEC--TAN"], [210.0, -25.0]
    wcs.wcs.crpix, wcs.wcs.cdelt = [SIZE / 2 + 0.5] * 2, [-0.001, 0.001]
    session = client.create_session(model_id, **OUTLINED, name="BOX").session_id
    client.add_background(session, fits_file()(SKY), "image/fits")
    for k, image in enumerate(FRAMES):
        hdu = fits.PrimaryHDU(image[::-1], wcs.to_header())
        hdu.header["DATE-AVG"] = (Time("2026-11-20T03:04:05.5") + k * units.s).isot
        file = io.BytesIO()
        hdu.writeto(file)
        client.put_frame(session, k, file.getvalue(), "image/fits")
    return session


def test_a_solved_frame_comes_back_with_its_pose_and_its_stars(client, history):
    estimate = client.estimate(history, 1)
    with fits.open(io.BytesIO(client.frame_fits(history, 1))) as found:
        found.verify("exception")
        np.testing.assert_array_equal(found[0].data[::-1], FRAMES[1])
        header, wcs = found[0].header, WCS(found[0].header)
    assert wcs.pixel_to_world(SIZE / 2 - 0.5, SIZE / 2 - 0.5).ra.deg == pytest.approx(210.0)
    assert header["POSE_X"] == estimate.best.x_px
    assert estimate.best.attitude is not None
    assert header["POSE_GW"] == pytest.approx(estimate.best.attitude.orientation.w)


def test_exports_are_read_by_other_programs(client, history):
    best = [estimate.best.attitude.orientation for estimate in client.estimates(history)]
    expected = np.array([[q.w, q.x, q.y, q.z] for q in best])

    def same(found) -> None:
        found = np.array(found)
        assert np.abs(np.sum(found * expected[-len(found) :], axis=1)) == pytest.approx(1.0, abs=1e-9)

    segments = AEM.from_str(client.export(history, "aem").decode()).segments  # the first without rates, which need two
    assert {segment.object_name for segment in segments} == {"BOX"}
    same([[getattr(state.quaternion, axis) for axis in "wxyz"] for one in segments for state in one.states])
    apm = APM.from_str(client.export(history, "apm").decode()).quaternion_states[0].quaternion
    same([[getattr(apm, axis) for axis in "wxyz"]])
    arrays = np.load(io.BytesIO(client.export(history, "npz")))
    same(arrays["attitude_gcrf"])
    rows = list(csv.DictReader(io.StringIO(client.export(history).decode())))
    same([[float(row[f"gcrf_q{axis}"]) for axis in "wxyz"] for row in rows])
    stk = client.export(history, "stk").decode().splitlines()
    lines = [line.split() for line in stk if line[:1].isdigit()]
    same([[float(line[4]), *map(float, line[1:4])] for line in lines if len(line) >= 5])
    assert json.loads(client.export(history, "czml"))[0]["id"] == "document"

"""Every format of frames through the service; time and pointing out of the file, unless the call says otherwise."""

import io
import re
import struct
from datetime import UTC, datetime, timedelta

import cv2
import numpy as np
import pytest
from astropy.io import fits

from service.attitude.camera import equatorial_camera
from service.imaging.decode import SUPPORTED
from service.inference.pose import rotation_matrices

pytestmark = pytest.mark.anyio

DEEP = np.random.default_rng(11).integers(0, 60_000, (16, 16), dtype=np.uint16)
CARDS = {"DATE-OBS": "2026-11-20T03:04:05", "EXPTIME": 1.0, "RA": 40.0, "DEC": -10.0, "POSANGLE": 25.0}


def as_fits(image, kind=fits.PrimaryHDU, **cards) -> bytes:
    hdu = kind(image)
    hdu.header.update(cards)
    stream = io.BytesIO()
    fits.HDUList([hdu] if kind is fits.PrimaryHDU else [fits.PrimaryHDU(), hdu]).writeto(stream)
    return stream.getvalue()


def as_npy(image) -> bytes:
    stream = io.BytesIO()
    np.save(stream, image)
    return stream.getvalue()


def as_imagebytes(image) -> bytes:
    height, width = image.shape
    return struct.pack("<11i", 1, 0, 1, 1, 44, 2, 8, 2, width, height, 0) + image.T.tobytes()


def as_ser(image) -> bytes:
    text = [b"", b"", b""]
    header = struct.pack("<14s7i40s40s40s2q", b"LUCAM-RECORDER", 0, 0, 0, 16, 16, 16, 1, *text, 0, 0)
    since = datetime(2026, 11, 20, 3, 4, 5, 500_000, UTC) - datetime(1, 1, 1, tzinfo=UTC)
    return header + image.tobytes() + struct.pack("<q", since // timedelta(microseconds=1) * 10)


BODIES = {
    "image/fits": as_fits(DEEP, **CARDS),
    "application/fits": as_fits(DEEP, fits.CompImageHDU, **CARDS),
    "image/png": cv2.imencode(".png", DEEP)[1].tobytes(),
    "image/tiff": cv2.imencode(".tiff", DEEP)[1].tobytes(),
    "image/jpeg": cv2.imencode(".jpg", (DEEP >> 8).astype(np.uint8))[1].tobytes(),
    "application/x-npy": as_npy(DEEP),
    "application/imagebytes": as_imagebytes(DEEP),
    "video/x-ser": as_ser(DEEP),
}
TIMED = ("image/fits", "application/fits", "video/x-ser")


async def post(api, session_id: str, media: str, what: str = "frames", **query):
    url = f"/v1/sessions/{session_id}/{what}"
    return await api.http.post(url, content=BODIES[media], headers={"Content-Type": media}, params=query)


@pytest.mark.parametrize("media", BODIES)
async def test_every_format_is_taken(api, media):
    session_id = await api.session()
    assert (await post(api, session_id, media, "background")).json()["background_frames"] == 1
    answer = await post(api, session_id, media)
    assert answer.status_code == 200, answer.text
    if media in TIMED:
        assert answer.json()["time"] == "2026-11-20T03:04:05.500Z"
    overlay = await api.http.get(f"/v1/sessions/{session_id}/estimates/0/overlay.png")
    assert overlay.status_code == 200


async def test_a_fits_header_gives_the_attitude_and_the_query_wins(api):
    session_id = await api.session()
    await post(api, session_id, "image/fits", "background")
    told = (await post(api, session_id, "image/fits")).json()
    axes = [equatorial_camera(40, -10, 25), equatorial_camera(41, -11, 25), equatorial_camera(40, -10, 0)]
    later = "2026-11-20T03:04:06Z"
    moved = (await post(api, session_id, "image/fits", ra_deg=41, dec_deg=-11, time=later)).json()
    turned = (await post(api, session_id, "image/fits", position_angle_deg=0, time=later)).json()
    for answer, expected in zip((told, moved, turned), axes, strict=True):
        found = np.array([answer["camera"]["orientation"][axis] for axis in "wxyz"])
        np.testing.assert_allclose(rotation_matrices(found), expected, atol=1e-12)
    assert moved["time"] == "2026-11-20T03:04:06.000Z"
    backwards = await post(api, session_id, "image/fits")
    assert (backwards.status_code, backwards.json()["field"]) == (422, "time")


async def test_a_damaged_file_changes_nothing(api):
    session_id = await api.session()
    await post(api, session_id, "image/fits", "background")
    url, body = f"/v1/sessions/{session_id}/frames", BODIES["image/fits"]
    refused = await api.http.post(url, content=body[:3000], headers={"Content-Type": "image/fits"})
    assert (refused.status_code, refused.json()["type"]) == (422, "urn:skypose:problem:broken-image")
    assert (await post(api, session_id, "image/fits")).json()["index"] == 0


async def test_the_documentation_lists_every_media_type(api):
    paths = (await api.http.get("/openapi.json")).json()["paths"]
    body = paths["/v1/sessions/{session_id}/frames"]["post"]["requestBody"]
    assert set(SUPPORTED) < set(re.findall(r"`([^`]+)`", body["description"]))
    assert list(body["content"]) == ["application/octet-stream"]


async def test_the_frame_comes_back_with_its_pose(api):
    session_id = await api.session()
    await post(api, session_id, "image/fits", "background")
    best = (await post(api, session_id, "image/fits")).json()["best"]
    await post(api, session_id, "image/png")
    answer = await api.http.get(f"/v1/sessions/{session_id}/estimates/0/frame.fits")
    assert answer.headers["content-type"] == "image/fits"
    with fits.open(io.BytesIO(answer.content)) as found, fits.open(io.BytesIO(BODIES["image/fits"])) as sent:
        found.verify("exception")
        np.testing.assert_array_equal(found[0].data, sent[0].data)
        cards = [[str(card) for card in file[0].header.cards] for file in (found, sent)]
        assert cards[0][: len(cards[1])] == cards[1]
        header = found[0].header
    assert [header[f"POSE_Q{a}"] for a in "WXYZ"] == pytest.approx([best["orientation"][a] for a in "wxyz"], abs=1e-12)
    gcrf = best["attitude"]["orientation"]
    assert [header[f"POSE_G{a}"] for a in "WXYZ"] == pytest.approx([gcrf[a] for a in "wxyz"], abs=1e-12)
    assert (header["POSE_IDX"], header["POSE_X"]) == (0, pytest.approx(best["x_px"]))
    assert (await api.http.get(f"/v1/sessions/{session_id}/estimates/9/frame.fits")).status_code == 404


@pytest.mark.parametrize("media", ["image/png", "video/x-ser", "application/imagebytes"])
async def test_a_frame_of_another_format_comes_back_as_a_new_file(api, media):
    session_id = await api.session()
    await post(api, session_id, media, "background")
    told = (await post(api, session_id, media, time="2026-11-20T03:04:05.25Z")).json()
    answer = await api.http.get(f"/v1/sessions/{session_id}/estimates/0/frame.fits")
    with fits.open(io.BytesIO(answer.content)) as found:
        found.verify("exception")
        np.testing.assert_array_equal(found[0].data[::-1], DEEP)
        header = found[0].header
    assert (header["DATE-AVG"], header["POSE_Y"]) == ("2026-11-20T03:04:05.250", told["best"]["y_px"])
    again = await api.http.post(
        f"/v1/sessions/{session_id}/frames", content=answer.content, headers={"Content-Type": "image/fits"}
    )
    assert (again.status_code, again.json()["time"]) == (200, told["time"])


async def test_what_headers_say_may_be_left_out(api):
    session_id = await api.session(camera={"headers": "ignore"})
    await post(api, session_id, "image/fits", "background")
    told = (await post(api, session_id, "image/fits")).json()
    assert told["camera"] is None and told["time"] != "2026-11-20T03:04:05.500Z"

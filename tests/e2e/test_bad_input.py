"""What hurts, through the real tracker: each is refused by name, the session is unharmed, the next good frame works."""

import io
import json
from collections.abc import AsyncIterator

import cv2
import numpy as np
import pytest
import trimesh
from api_client import Api, running
from passes import PNG, box_pass

from service.main import create_app
from service.settings import Settings
from service.workers.inline import InlineTransport
from service.workers.tracker import Tracker

pytestmark = pytest.mark.anyio
GIVEN = box_pass(2)


@pytest.fixture(scope="module")
async def api(tmp_path_factory, anyio_backend) -> AsyncIterator[Api]:
    settings = Settings(data_dir=tmp_path_factory.mktemp("data"))
    async with running(create_app(settings, InlineTransport(Tracker))) as api:
        yield api


def png(pixels: np.ndarray) -> bytes:
    return cv2.imencode(".png", pixels)[1].tobytes()


def stl(vertices: np.ndarray, faces: np.ndarray) -> bytes:
    file = io.BytesIO()
    trimesh.Trimesh(vertices, faces, process=False).export(file, file_type="stl")
    return file.getvalue()


BOX = trimesh.creation.box((1, 1, 1))
WITH_NAN = np.where(np.arange(24).reshape(8, 3) == 5, np.nan, BOX.vertices)
MESHES = {
    "empty.stl": b"",
    "junk.glb": b"junk" * 100,
    "no_faces.obj": b"v 0 0 0\nv 1 0 0\nv 0 1 0\n",
    "nan.stl": stl(WITH_NAN, BOX.faces),
    "flat_points.stl": stl(np.zeros((3, 3)), np.array([[0, 1, 2]])),
    "cut.glb": trimesh.Scene(BOX).export(file_type="glb")[:-200],
    "binary.ply": b"ply\nformat binary_little_endian 1.0\nelement vertex 4000000000\nproperty float x\nend_header\n",
    "text.obj": b"f 1 2 3\n",
}
TOO_LARGE = ("binary.ply",)


@pytest.mark.parametrize("name", MESHES)
async def test_bad_mesh(api, name):
    answer = await api.http.post("/v1/models", files={"file": (name, MESHES[name])})
    assert answer.status_code == (413 if name in TOO_LARGE else 422), answer.text
    assert answer.json()["type"].rpartition(":")[2] in ("broken-mesh", "invalid-input", "too-large")
    assert answer.json()["field"] == "file"


@pytest.mark.parametrize(
    "joint",
    [
        {},
        {"name": "a", "kind": "ball", "parts": ["x"], "axis": [0, 0, 1], "origin": [0, 0, 0], "min": 0, "max": 1},
        {"name": "a", "kind": "revolute", "parts": ["no such"], "axis": [0, 0, 1], "origin": [0, 0, 0]},
        {"name": "a", "kind": "revolute", "parts": [], "axis": [0, 0, 0], "origin": [0, 0, 0], "min": 0, "max": 1},
    ],
)
async def test_bad_joint(api, joint):
    data = {"joints": json.dumps([joint])}
    answer = await api.http.post("/v1/models", files={"file": ("box.stl", GIVEN.mesh)}, data=data)
    assert (answer.status_code, answer.json()["type"]) == (422, "urn:skypose:problem:invalid-joint"), answer.text


GOOD = GIVEN.frames[0]
WIDE = png(np.zeros((64, 65), np.uint8))
FRAMES = {
    "truncated": (GOOD[: len(GOOD) // 2], "image/png", 422, "broken-image"),
    "cut at the end": (GOOD[:-1], "image/png", 422, "broken-image"),
    "junk": (b"junk", "image/png", 422, "broken-image"),
    "wrong type": (GOOD, "text/plain", 415, "unsupported-media-type"),
    "no type": (GOOD, "", 415, "unsupported-media-type"),
    "other format than it says": (GOOD, "image/jpeg", 422, "broken-image"),
    "other size": (WIDE, "image/png", 422, "image-mismatch"),
    "other depth": (png(np.zeros((64, 64), np.uint16)), "image/png", 422, "image-mismatch"),
    "other channels": (png(np.zeros((64, 64, 3), np.uint8)), "image/png", 422, "image-mismatch"),
    "bomb": (
        GOOD[:16] + (100_000).to_bytes(4, "big") * 2 + GOOD[24:],  # a header of 100,000 x 100,000 pixels
        "image/png",
        (413, 422),
        ("too-large", "broken-image"),
    ),
}


async def test_bad_frames_leave_the_session_as_it_was(api):
    model_id = (await api.http.post("/v1/models", files={"file": ("box.stl", GIVEN.mesh)})).json()["model_id"]
    small = {"particles": 100}
    body = {"model_id": model_id, "filter": small, "light": {"sun": [0.0, 0.0, -1.0]}}
    session_id = (await api.http.post("/v1/sessions", json=body)).json()["session_id"]
    here = f"/v1/sessions/{session_id}"
    early = await api.http.post(f"{here}/frames", content=GOOD, headers=PNG)
    assert (early.status_code, early.json()["type"]) == (409, "urn:skypose:problem:no-background")
    for image in GIVEN.background:
        assert (await api.http.post(f"{here}/background", content=image, headers=PNG)).status_code == 200
    assert (await api.http.post(f"{here}/background", content=WIDE, headers=PNG)).status_code == 422
    for n, image in enumerate(GIVEN.frames):
        for name, (content, kind, status, slug) in FRAMES.items():
            before = (await api.http.get(here)).json()
            answer = await api.http.post(f"{here}/frames", content=content, headers={"Content-Type": kind})
            statuses = status if isinstance(status, tuple) else (status,)
            slugs = slug if isinstance(slug, tuple) else (slug,)
            assert answer.status_code in statuses, (name, answer.text)
            assert answer.json()["type"].rpartition(":")[2] in slugs, (name, answer.text)
            assert answer.json()["field"], name
            assert (await api.http.get(here)).json() == before
        good = await api.http.post(f"{here}/frames", content=image, headers=PNG)
        assert (good.status_code, good.json()["index"]) == (200, n)

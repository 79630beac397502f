"""A body before clutter through the service: a box is all that it is told, and a restart in between changes nothing."""

import numpy as np
import pytest
import trimesh
from api_client import PNG, running
from cluttered import FIXED, LENS, MESH, SIZE, scene

from gpu.reference import silhouette_mask
from service.bench.silhouette import overlap
from service.inference.articulation import part_transforms
from service.inference.state import Poses
from service.simulate.folder import encode_png
from service.workers.tracker import Tracker

pytestmark = pytest.mark.anyio
FRAMES = 3


def mesh_file() -> bytes:
    parts = {part.name: trimesh.Trimesh(part.vertices, part.faces, process=False) for part in MESH.parts}
    return trimesh.Scene(parts).export(file_type="glb")


async def begun(api, seen) -> str:
    model = (await api.model(mesh_file(), "body.glb")).json()
    camera = {"perspective": LENS.focal, "principal_point": LENS.middle}
    request = {"model_id": model["model_id"], "camera": camera, "filter": {"particles": 200}}
    session_id = (await api.http.post("/v1/sessions", json=request)).json()["session_id"]
    where = f"/v1/sessions/{session_id}/background?box={','.join(map(str, seen.box))}"
    answer = await api.http.post(where, content=encode_png(seen.frames[0]), headers=PNG)
    assert answer.status_code == 200, answer.text
    return session_id


async def answered(api, session_id: str, frame: np.ndarray) -> dict:
    answer = await api.http.post(f"/v1/sessions/{session_id}/frames", content=encode_png(frame), headers=PNG)
    assert answer.status_code == 200, answer.text
    return answer.json()


def pose_of(told: dict) -> Poses:
    turn = np.array([[told["orientation"][k] for k in "wxyz"]])
    return Poses(turn, np.array([[told["x_px"], told["y_px"]]]), np.log([told["scale_px"]]), np.zeros((1, 0)))


async def test_a_body_before_clutter_is_followed_over_a_restart(make_app):
    seen = scene(FRAMES, seed=3)
    async with running(make_app(Tracker)) as api:
        whole, broken = await begun(api, seen), await begun(api, seen)
        told = [await answered(api, whole, frame) for frame in seen.frames]
        first = await answered(api, broken, seen.frames[0])
        picture = await api.http.get(f"/v1/sessions/{whole}/estimates/{FRAMES - 1}/residual.png")
        assert picture.headers["content-type"] == "image/png"
    async with running(make_app(Tracker)) as api:
        again = [first, *[await answered(api, broken, frame) for frame in seen.frames[1:]]]
    for one, other, mask in zip(told, again, seen.masks, strict=True):
        assert one["status"] == "ambiguous" and one["best"] == other["best"] and one["spread"] == other["spread"]
        lens = LENS.focal, *LENS.middle
        drawn = silhouette_mask(MESH, part_transforms(FIXED, pose_of(one["best"]))[0], (SIZE, SIZE), lens)
        assert overlap(drawn, mask) > 0.9

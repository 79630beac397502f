"""Which spacecraft is this, on a public sequence: a few frames of the shuttle under three models."""

from pathlib import Path

import pytest
from api_client import PNG, running

from service.workers.tracker import Tracker

pytestmark = pytest.mark.anyio
DATA = Path(__file__).resolve().parents[3] / "shared" / "data"
MESHES = ("hubble", "shuttle_orbiter", "tdrs")
FRAMES = 3


@pytest.mark.long
@pytest.mark.skipif(not DATA.exists(), reason="no shared data beside the checkout")
async def test_the_shuttle_is_recognised(make_app):
    async with running(make_app(Tracker, max_model_mb=256)) as api:
        ids = []
        for name in MESHES:
            data = (DATA / "meshes" / f"{name}.glb").read_bytes()
            ids.append((await api.model(data, f"{name}.glb")).json()["model_id"])
        session_id = (await api.http.post("/v1/sessions", json={"model_ids": ids})).json()["session_id"]
        here, sequence = f"/v1/sessions/{session_id}", DATA / "sequences" / "shuttle_night"
        for path in sorted((sequence / "background").glob("*.png")):
            await api.http.post(f"{here}/background", content=path.read_bytes(), headers=PNG)
        for path in sorted((sequence / "frames").glob("*.png"))[:FRAMES]:
            answer = await api.http.post(f"{here}/frames", content=path.read_bytes(), headers=PNG)
    ranked = answer.json()["models"]
    assert ranked[0]["model_id"] == ids[1]
    assert ranked[0]["probability"] > 0.99

"""Sessions of several models: which spacecraft is this."""

from dataclasses import replace
from hashlib import sha256

import numpy as np
import orjson
import pytest
from api_client import PNG, image, running
from fake_worker import CUBE, FakeWorker

from gpu.mesh import load_mesh
from service.inference.belief import Belief
from service.sessions.checkpoint import Checkpoint
from service.simulate.folder import encode_png
from service.simulate.glb_writer import SolidNode, write_glb
from service.simulate.motion import Motion
from service.simulate.primitives import box
from service.simulate.satellite import demo_satellite
from service.simulate.scenario import Scenario
from service.simulate.sequence import SimulatedPass
from service.workers.base import ModelJob
from service.workers.codec import decode, encode
from service.workers.tracker import Tracker

pytestmark = pytest.mark.anyio
CUBES = (CUBE + b" one joint", CUBE + b" two", CUBE + b" three")


async def comparison(api, *, files=CUBES, **body) -> tuple[str, list[str]]:
    models = [(await api.model(data, "cube.glb")).json()["model_id"] for data in files]
    answer = await api.http.post("/v1/sessions", json={"model_ids": models, **body})
    assert answer.status_code == 201, answer.text
    assert (answer.json()["model_id"], answer.json()["model_ids"]) == (None, models)
    return answer.json()["session_id"], models


async def ready_comparison(api) -> tuple[str, list[str]]:
    session_id, models = await comparison(api, joints={"free": "all"})
    await api.http.post(f"/v1/sessions/{session_id}/background", content=image(), headers=PNG)
    return session_id, models


async def test_each_estimate_ranks_the_models(api):
    session_id, models = await ready_comparison(api)
    for n in range(3):
        answer = (await api.put(session_id, n, n)).json()
        assert sorted(m["model_id"] for m in answer["models"]) == sorted(models)
        assert sum(m["probability"] for m in answer["models"]) == pytest.approx(1)
    # The fake's evidence is minus the time, 0, 0.1, 0.2 s, under every model.
    assert [m["log_evidence"] for m in answer["models"]] == pytest.approx([-0.3] * 3)
    assert [m["probability"] for m in answer["models"]] == pytest.approx([1 / 3] * 3)
    here = f"/v1/sessions/{session_id}"
    assert (await api.http.get(f"{here}/particles")).json()["joint_names"] == ["panel"]
    assert (await api.http.get(f"{here}/estimates/1/overlay.png")).status_code == 200


async def test_exactly_once_and_across_a_restart(make_app):
    async with running(make_app()) as api:
        session_id, _ = await ready_comparison(api)
        first = [(await api.put(session_id, n, n)).json() for n in range(4)]
    async with running(make_app()) as api:
        whole, _ = await ready_comparison(api)
        for n in range(2):
            await api.put(whole, n, n)
    async with running(make_app()) as api:
        assert (await api.put(whole, 1, 1)).json()["duplicate"] is True
        assert (await api.put(whole, 1, 7)).status_code == 409
        again = [(await api.put(whole, n, n)).json() for n in range(2, 4)]
    for one, other in zip(first[2:], again, strict=True):
        assert (one["best"], one["models"]) == (other["best"], other["models"])


class Fickle(FakeWorker):
    """Thinks that it is the first model, and from the third frame on that it is the second."""

    def track(self, job):
        report = super().track(job)
        likely = job.model == sha256(CUBES[0 if job.frame_index < 2 else 1]).hexdigest()
        evidence = (10.0 if job.frame_index < 2 else 100.0) if likely else 0.0
        size = report.state.rates.shape[1]
        spread = 1e-4 * np.eye(2 * size)[None]
        belief = Belief(job.time_s, 1.0, np.zeros(1), report.state.poses[slice(1)], np.zeros((1, size)), spread)
        return replace(report, estimate=replace(report.estimate, log_evidence=evidence), belief=belief)


async def test_goes_on_from_its_checkpoint(make_app, tmp_path):
    async with running(make_app(Fickle)) as one, running(make_app(Fickle, data_dir=tmp_path / "other")) as two:
        session_id, _ = await ready_comparison(one)
        here = f"/v1/sessions/{session_id}"
        empty = (await one.http.get(f"{here}/checkpoint")).content
        assert (await two.http.put(f"{here}/checkpoint", content=empty)).status_code == 201
        for n in range(2):
            await one.put(session_id, n, n)
        blob = (await one.http.get(f"{here}/checkpoint")).content
        assert (await two.http.put(f"{here}/checkpoint", content=blob)).status_code == 200
        for n in range(1, 5):  # the second of them again, then three more
            answers = [(await server.put(session_id, n, n)).json() for server in (one, two)]
            assert answers[0]["best"] == answers[1]["best"]
            assert answers[0]["models"] == answers[1]["models"]
        assert (await two.http.get(f"{here}/particles")).json() == (await one.http.get(f"{here}/particles")).json()
        # A comparison of other models is no earlier stand of it.
        other, _ = await comparison(two, files=CUBES[:2])
        assert (await two.http.put(f"/v1/sessions/{other}/checkpoint", content=blob)).status_code == 409


async def test_forged_checkpoints_of_comparisons(make_app, tmp_path):
    async with running(make_app(Fickle)) as one, running(make_app(Fickle, data_dir=tmp_path / "other")) as two:
        session_id, _ = await ready_comparison(one)
        for n in range(2):
            await one.put(session_id, n, n)
        good = decode(Checkpoint, (await one.http.get(f"/v1/sessions/{session_id}/checkpoint")).content)
        rows = orjson.loads(good.compared.rows.tobytes())
        text = np.frombuffer(orjson.dumps([*rows[:-1], {**rows[-1], "log_evidence": 1e9}]), np.uint8)
        fewer = np.frombuffer(orjson.dumps(rows[:2]), np.uint8)
        states = {**good.compared.states, "0": good.compared.states["1"]}
        wrong = [
            replace(good, compared=None),
            replace(good, compared=replace(good.compared, rows=text)),  # what the newest estimate does not say
            replace(good, compared=replace(good.compared, rows=fewer)),
            replace(
                good, compared=replace(good.compared, files={**good.compared.files, "0": good.compared.files["1"]})
            ),
            replace(good, compared=replace(good.compared, states=states)),
            replace(good, compared=replace(good.compared, states={})),
        ]
        for forged in wrong:
            answer = await two.http.put("/v1/sessions/x/checkpoint", content=encode(forged))
            assert answer.status_code == 422, answer.text
        assert (await two.http.get("/v1/sessions")).json()["sessions"] == []


async def test_export_and_smoothing_follow_the_model_that_leads(make_app):
    async with running(make_app(Fickle)) as api:
        session_id, models = await ready_comparison(api)
        here = f"/v1/sessions/{session_id}"
        assert len((await api.http.get(f"{here}/export?format=csv")).text.splitlines()) == 1
        for n, leads in enumerate((0, 0, 1, 1)):
            answer = (await api.put(session_id, n, n)).json()
            assert answer["models"][0]["model_id"] == models[leads]
            lines = (await api.http.get(f"{here}/export?format=csv")).text.splitlines()
            assert len(lines) == 1 + (n + 1 if n < 2 else n - 1)
        assert [line.split(",")[0] for line in lines[1:]] == ["2", "3"]
        smoothed = (await api.http.get(f"{here}/estimates?smoothed=true")).json()["estimates"]
        assert [estimate["smoothed"] for estimate in smoothed] == [False, False, True, True]
        assert [set(estimate["best"]["joints"]) for estimate in smoothed] == [{"panel"}] * 2 + [set()] * 2


async def test_what_is_refused(api):
    session_id, models = await ready_comparison(api)
    await api.put(session_id, 0, 0)
    here = f"/v1/sessions/{session_id}"
    for body in (
        {},
        {"model_id": models[0], "model_ids": models},
        {"model_ids": models[:1]},
        {"model_ids": [models[0]] * 2},
        {"model_ids": models, "joints": {"free": ["panel"]}},  # the second has no joints
    ):
        assert (await api.http.post("/v1/sessions", json=body)).status_code == 422, body
    assert (await api.http.post("/v1/sessions", json={"model_ids": [models[0], "none"]})).status_code == 404
    assert (await api.http.delete(f"/v1/models/{models[1]}")).status_code == 409
    assert (await api.http.delete(here)).status_code == 204
    assert (await api.http.delete(f"/v1/models/{models[1]}")).status_code == 204


def shortened() -> bytes:
    """A satellite of the same bus without joint, dish and boom, and with a wing of half the length."""
    bus = box((2.6, 1.6, 1.5))
    wing = box((1.7, 2.6, 0.06)).moved((0.65, 2.4, 0.35))
    return write_glb("short", [SolidNode("bus", bus), SolidNode("wing", wing)])


@pytest.mark.parametrize("real", [0, pytest.param(1, marks=pytest.mark.long)])
async def test_the_right_one_of_two_satellites_is_found(make_app, real):
    """Whichever of them flies, its probability is near one; a joint more is no advantage."""
    files = (demo_satellite(), shortened())
    tracker = Tracker()
    articulation = tracker.prepare_model(ModelJob(files[real], "glb")).articulation
    tracker.close()
    motion = Motion(frames=3, joint_start_deg=20.0)
    simulated = SimulatedPass(load_mesh(files[real], "glb"), articulation, Scenario("", size=(96, 96), motion=motion))
    given = {"filter": {"particles": 300}, "light": {"sun": simulated.light(0).direction().tolist()}}
    async with running(make_app(Tracker)) as api:
        session_id, models = await comparison(api, files=files, joints={"free": "all"}, **given)
        here = f"/v1/sessions/{session_id}"
        for frame in simulated.backgrounds():
            await api.http.post(f"{here}/background", content=encode_png(frame), headers=PNG)
        for frame in simulated.frames():
            answer = await api.http.post(f"{here}/frames", content=encode_png(frame), headers=PNG)
    ranked = answer.json()["models"]
    assert ranked[0]["model_id"] == models[real]
    assert ranked[0]["probability"] > 0.99
    assert set(answer.json()["best"]["joints"]) == {joint.name for joint in articulation.joints}
    assert np.isfinite([m["log_evidence"] for m in ranked]).all()

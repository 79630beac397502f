"""A pass whose Sun is told, through the API: what its estimates add, and a session that is moved on without its Sun."""

import numpy as np
import pytest
from api_client import PNG, running
from fake_worker import CUBE

from gpu.mesh import load_mesh
from service.inference.pose import angle_between
from service.simulate.folder import encode_png
from service.simulate.motion import Motion
from service.simulate.satellite import demo_satellite
from service.simulate.scenario import Scenario
from service.simulate.sequence import SimulatedPass
from service.workers.base import ModelJob
from service.workers.tracker import Tracker

pytestmark = pytest.mark.anyio
FRAMES, BLANK = 4, 3  # the last one shows the sky


def the_pass() -> SimulatedPass:
    tracker = Tracker()
    articulation = tracker.prepare_model(ModelJob(demo_satellite(), "glb")).articulation
    tracker.close()
    scenario = Scenario("", size=(128, 128), motion=Motion(frames=FRAMES, joints=()))
    return SimulatedPass(load_mesh(demo_satellite(), "glb"), articulation, scenario)


async def tracked(api, sun) -> list[dict]:
    model = (await api.model(demo_satellite(), "demo.glb")).json()
    request = {"model_id": model["model_id"], "filter": {"particles": 200}, "light": {"sun": sun}}
    session_id = (await api.http.post("/v1/sessions", json=request)).json()["session_id"]
    simulated = the_pass()
    empty = [encode_png(image) for image in simulated.backgrounds()]
    for body in empty:
        await api.http.post(f"/v1/sessions/{session_id}/background", content=body, headers=PNG)
    answers = []
    for k, image in enumerate(simulated.frames()):
        body = empty[0] if k == BLANK else encode_png(image)
        answer = await api.http.post(f"/v1/sessions/{session_id}/frames", content=body, headers=PNG)
        assert answer.status_code == 200, answer.text
        answers.append(answer.json())
    return answers


async def test_a_told_sun_brings_probabilities_and_the_goodness_of_the_fit(make_app):
    simulated = the_pass()
    sun = [float(v) for v in simulated.light(0).direction()]
    async with running(make_app(Tracker)) as api:
        answers = await tracked(api, sun)
    for answer in answers:
        assert answer["scorer"] == "light"
        assert sum(answer["probabilities"].values()) == pytest.approx(1.0)
        assert sum(mode["weight"] for mode in answer["modes"]) == pytest.approx(1.0)
        assert set(answer["fit"]) == {"chi2", "explained", "covered_dark"}
        assert answer["spread_all"]["covariance_order"] == answer["spread"]["covariance_order"]
    assert [answer["status"] for answer in answers] == ["tracking", "tracking", "tracking", "no_target"]
    for k, answer in enumerate(answers[:BLANK]):
        found = np.array([[answer["best"]["orientation"][name] for name in "wxyz"]])
        assert np.rad2deg(angle_between(found, simulated.track.poses.quaternion[k : k + 1])[0]) < 5.0
    assert answers[0]["rates"] is None and answers[1]["rates"] is not None


async def test_without_a_sun_nothing_is_added(api):
    session_id = await api.ready_session(CUBE)
    answer = (await api.post(session_id, 0)).json()
    assert not {"probabilities", "fit", "spread_all"} & set(answer)

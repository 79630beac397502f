"""`GET …/estimates?smoothed=true`: the same frames, each with what came after taken into account."""

import csv
import io
from typing import ClassVar

import numpy as np
import pytest
from api_client import PNG, running
from fake_worker import CUBE, FakeWorker

from gpu.mesh import load_mesh
from service.simulate.folder import encode_png
from service.simulate.motion import Motion
from service.simulate.satellite import demo_satellite
from service.simulate.scenario import Scenario
from service.simulate.sequence import SimulatedPass
from service.workers.base import ModelJob
from service.workers.tracker import Tracker

pytestmark = pytest.mark.anyio
CAMERA = {"ra_deg": 120.0, "dec_deg": 20.0, "position_angle_deg": 15.0}


async def test_without_anything_known_the_filters_answer_stays(api):
    session_id = await api.ready_session(CUBE)
    for n in range(3):
        await api.post(session_id, n)
    here = f"/v1/sessions/{session_id}/estimates"
    plain = (await api.http.get(here)).json()["estimates"]
    page = (await api.http.get(f"{here}?smoothed=true&limit=2")).json()
    assert page["next"] == f"{here}?after=1&limit=2&smoothed=true"
    rest = (await api.http.get(page["next"])).json()
    assert page["estimates"] + rest["estimates"] == [{**e, "smoothed": False} for e in plain]
    assert rest["next"] is None
    assert (await api.http.get(f"{here}?smoothed=true&after=9")).json() == {"estimates": [], "next": None}
    assert (await api.http.get("/v1/sessions/none/estimates?smoothed=true")).status_code == 404


class Counting(FakeWorker):
    """Notes how many frames each smoothing goes back over."""

    lengths: ClassVar[list[int]] = []

    def smooth(self, job):
        self.lengths.append(len(job.beliefs))
        return super().smooth(job)


async def test_pages_come_out_of_one_way_back(make_app):
    Counting.lengths.clear()
    async with running(make_app(Counting)) as api:
        session_id = await api.ready_session(CUBE)
        for n in range(6):
            await api.post(session_id, n)
        url = f"/v1/sessions/{session_id}/estimates?smoothed=true&limit=2"
        while url:
            url = (await api.http.get(url)).json()["next"]
        assert Counting.lengths == [6]
        await api.post(session_id, 6)  # another stand: all is smoothed anew
        await api.http.get(f"/v1/sessions/{session_id}/estimates?smoothed=true&after=3")
        await api.http.get(f"/v1/sessions/{session_id}/estimates?smoothed=true&after=1")  # more than is there
        assert Counting.lengths == [6, 3, 5]


async def simulated_session(api) -> str:
    model = (await api.model(demo_satellite(), "demo.glb")).json()
    request = {"model_id": model["model_id"], "filter": {"particles": 200}, "light": {"sun": [0.0, 0.0, -1.0]}}
    session_id = (await api.http.post("/v1/sessions", json=request)).json()["session_id"]
    tracker = Tracker()
    simulated = SimulatedPass(*tracker_model(tracker), Scenario("", size=(96, 96), motion=Motion(frames=5, joints=())))
    tracker.close()
    for image in simulated.backgrounds():
        await api.http.post(f"/v1/sessions/{session_id}/background", content=encode_png(image), headers=PNG)
    for k, image in enumerate(simulated.frames()):
        query = {**CAMERA, "time": f"2026-11-20T03:04:05.{k}Z"}
        url = f"/v1/sessions/{session_id}/frames"
        answer = await api.http.post(url, content=encode_png(image), headers=PNG, params=query)
        assert answer.status_code == 200, answer.text
    return session_id


def tracker_model(tracker: Tracker):
    return load_mesh(demo_satellite(), "glb"), tracker.prepare_model(ModelJob(demo_satellite(), "glb")).articulation


async def test_a_pass_is_smoothed_although_its_particles_are_gone(make_app):
    async with running(make_app(Tracker, keep_particle_sets=1, keep_particle_every=0)) as api:
        session_id = await simulated_session(api)
        here = f"/v1/sessions/{session_id}/estimates"
        plain = (await api.http.get(here)).json()["estimates"]
        smoothed = (await api.http.get(f"{here}?smoothed=true")).json()["estimates"]
        page = (await api.http.get(f"{here}?smoothed=true&after=2&limit=2")).json()["estimates"]
        export = f"/v1/sessions/{session_id}/export"
        table, as_filtered = [(await api.http.get(f"{export}{query}")).text for query in ("?smoothed=true", "")]
        ended = f"UPDATE sessions SET ended_at = '2026-11-20T00:00:00Z' WHERE id LIKE '%{session_id}'"
        await api.app.state.services.archive.database.write(lambda c: c.exec_driver_sql(ended) and None)
        assert (await api.http.get(export)).text == table != as_filtered
        assert (await api.http.get(f"{export}?smoothed=false")).text == as_filtered
    assert page == smoothed[3:5]
    told = [float(row["qw"]) for row in csv.DictReader(io.StringIO(table))]
    assert told == [e["best"]["orientation"]["w"] for e in smoothed] != [e["best"]["orientation"]["w"] for e in plain]
    assert [e["smoothed"] for e in smoothed] == [True] * 5
    kept = ("index", "time", "status", "log_evidence", "particles", "ess", "scorer", "camera")
    for before, after in zip(plain, smoothed, strict=True):
        assert {name: before[name] for name in kept} == {name: after[name] for name in kept}
        assert after["best"]["log_likelihood"] is None
        assert sum(mode["weight"] for mode in after["modes"]) == pytest.approx(1.0, abs=0.01)
    assert plain[0]["rates"] is None
    assert smoothed[0]["rates"] is not None  # later frames tell how the first one turned
    same, last = plain[-1]["modes"][0]["pose"], smoothed[-1]["modes"][0]["pose"]
    assert abs(np.dot(quaternion(same), quaternion(last))) > np.cos(np.deg2rad(0.1))  # nothing came after it
    for estimate in smoothed:  # the same camera turns pose into attitude, with its rate
        attitude = estimate["best"]["attitude"]
        assert attitude["frame"] == "GCRF"
        assert ("angular_velocity_body_deg_s" in attitude) == (estimate["index"] > 0)


def quaternion(pose: dict) -> list[float]:
    return [pose["orientation"][axis] for axis in "wxyz"]

"""`GET …/motion`: how the object of a session turned, from what the frames said."""

import asyncio
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from typing import ClassVar

import numpy as np
import pytest
from api_client import running
from fake_worker import CUBE, FakeWorker

from service.api.motion import PassMotion
from service.attitude.camera import Site, equatorial_camera
from service.attitude.held import held_frames
from service.attitude.orbit import Orbit
from service.cli.motion import lines
from service.client import AsyncClient
from service.inference.belief import Belief
from service.inference.pose import exp_so3, from_matrices, multiply, rotation_matrices
from service.inference.state import Poses

pytestmark = pytest.mark.anyio
RATE = np.deg2rad([3.0, -1.0, 2.0])
START = datetime(2026, 11, 20, 12, 0, tzinfo=UTC)
TLE = """1 25544U 98067A   26324.50000000  .00016717  00000-0  10270-3 0  9009
2 25544  51.6400 208.9163 0006317  69.9862  25.2906 15.49815350 10000"""
CAMERA = {"ra_deg": 120.0, "dec_deg": 20.0, "position_angle_deg": 15.0}


class Turning(FakeWorker):
    """Tells of a body that turns at ``RATE``, half a degree off in each frame and sure of that."""

    jobs: ClassVar[list] = []

    def orientation(self, index: int) -> np.ndarray:
        return exp_so3(RATE * 0.5 * index)

    def track(self, job):
        rng = np.random.default_rng(job.frame_index)
        turn = self.orientation(job.frame_index)[None]
        error = exp_so3(np.deg2rad(0.5) * rng.normal(size=(1, 3)))
        pose = Poses(multiply(turn, error), np.zeros((1, 2)), np.zeros(1), np.zeros((1, 0)))
        covariance = np.diag([2 * np.deg2rad(0.5) ** 2] * 3 + [0.1] * 9)[None]
        belief = Belief(job.time_s, 1.0, np.zeros(1), pose, np.zeros((1, 6)), covariance, each=True)
        report = super().track(job)
        best = replace(report.estimate.best, quaternion=pose.quaternion[0])
        return replace(report, estimate=replace(report.estimate, best=best), belief=belief)

    def motion(self, job):
        self.jobs.append(job)
        return super().motion(job)


async def test_the_rate_of_a_pass_in_body_and_gcrf(make_app):
    Turning.jobs.clear()
    async with running(make_app(Turning)) as api:
        session_id = await api.ready_session(CUBE)
        here = f"/v1/sessions/{session_id}/motion"
        assert (await api.http.get("/v1/sessions/none/motion")).status_code == 404
        for n in range(30):
            if n == 2:
                refused = await api.http.get(here)
            await api.post(session_id, n, time=f"2026-11-20T03:04:{5 + n / 2:09.6f}Z", **CAMERA)
        assert refused.status_code == 409
        assert refused.json()["needed"] == 3
        first, second = await asyncio.gather(api.http.get(here), api.http.get(here))
        found = first.json()
        assert second.json() == (await api.http.get(here)).json() == found
        assert len(Turning.jobs) == 2  # the refused one, and one for all three answers
        async with AsyncClient("http://127.0.0.1", transport=api.http._transport) as client:
            assert (await client.motion(session_id)).model_dump(mode="json") == found
    assert (found["model"], found["relative_to"], found["inertia"]) == ("constant_rate", "GCRF", None)
    assert sum(found["probabilities"].values()) == pytest.approx(1.0)
    assert found["frames"] == {"stored": 30, "used": 30, "explained": 1.0}
    assert found["epoch"] == "2026-11-20T03:04:12.250Z"
    rate, sigma = vector(found["angular_velocity_body_deg_s"]), vector(found["sigma_deg_s"])
    assert np.all(np.abs(rate - np.rad2deg(RATE)) < 5 * sigma)
    assert np.all(sigma < 0.1)
    assert found["period_s"] == pytest.approx(360 / np.linalg.norm(rate))
    axis = vector(found["axis_gcrf"])
    turned = rotation_matrices(np.array([found["orientation"][k] for k in "wxyz"])) @ rate
    np.testing.assert_allclose(axis, turned / np.linalg.norm(turned), atol=1e-9)


class Nadir(Turning):
    """Tells of a body whose -y points to nadir, three degrees off in pitch; the camera stands still."""

    def orientation(self, index: int) -> np.ndarray:
        moment = START + timedelta(seconds=index / 2)
        frame = held_frames(Orbit(TLE), Site(48.0, 16.0), [moment])["nadir_pointing"][0]
        body = rotation_matrices(exp_so3(np.deg2rad([0.0, 3.0, 0.0]))) @ np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]])
        return from_matrices(equatorial_camera(120.0, 20.0, 15.0).T @ frame @ body)


async def test_a_body_held_to_nadir_is_told_so(make_app):
    camera = {"site_latitude_deg": 48.0, "site_longitude_deg": 16.0}
    async with running(make_app(Nadir)) as api:
        session_id = await api.ready_session(CUBE, camera=camera, prior={"orbit": TLE})
        for n in range(40):
            time = (START + timedelta(seconds=n / 2)).isoformat()
            answer = await api.post(session_id, n, time=time, **CAMERA)
            assert answer.status_code == 200, answer.text
        found = (await api.http.get(f"/v1/sessions/{session_id}/motion")).json()
    mode = found["attitude_mode"]
    assert mode["mode"] == "nadir_pointing"
    assert mode["probabilities"]["nadir_pointing"] > 0.9
    assert sum(mode["probabilities"].values()) == pytest.approx(1.0)
    assert mode["body_axis"] == "-y"
    assert mode["offset_axes_deg"]["pitch"] == pytest.approx(3.0, abs=5 * mode["sigma_axes_deg"]["pitch"])
    assert mode["offset_deg"] == pytest.approx(3.0, abs=5 * mode["sigma_deg"])
    assert mode["sigma_deg"] < 0.5
    said = lines(PassMotion.model_validate(found))
    assert [line.split()[0] for line in said] == [
        *("model", "rate", "body", "period", "axis", "axis", "mode", "frames", "certainty"),
        *(["note"] * len(found["warnings"])),
    ]
    assert "nadir pointing" in said[6]
    assert found["joints"] == []  # the cube has none
    wing = {"name": "wing", "law": "still", "probabilities": {"still": 0.97, "sun_tracking": 0.02, "neither": 0.01}}
    wing |= {"value_deg": 12.5, "offset_deg": None, "sigma_deg": 0.4}
    assert "joint      wing: still (p 0.970), 12.50 ± 0.40°" in lines(
        PassMotion.model_validate({**found, "joints": [wing]})
    )


async def test_without_a_camera_rates_are_against_the_image(make_app):
    async with running(make_app(Turning)) as api:
        session_id = await api.ready_session(CUBE)
        for n in range(4):
            await api.post(session_id, n, time=f"2026-11-20T03:04:{5 + n / 2:09.6f}Z")
        found = (await api.http.get(f"/v1/sessions/{session_id}/motion")).json()
    assert found["relative_to"] == "camera"
    assert found["axis_gcrf"] is found["attitude_mode"] is None
    assert any("camera" in warning for warning in found["warnings"])
    assert vector(found["sigma_deg_s"]).max() > 0.1  # four frames tell little


def vector(axes: dict[str, float]) -> np.ndarray:
    return np.array([axes[name] for name in "xyz"])


class Doubting(Turning):
    """The same, never sure that it is this body."""

    def track(self, job):
        report = super().track(job)
        return replace(report, estimate=replace(report.estimate, probabilities=np.array([0.0, 0.62, 0.38])))


async def test_a_course_is_as_probable_as_that_the_truth_is_among_the_modes(make_app):
    async with running(make_app(Doubting)) as api:
        session_id = await api.ready_session(CUBE)
        for n in range(12):
            time = (START + timedelta(seconds=n / 2)).isoformat()
            assert (await api.post(session_id, n, time=time, **CAMERA)).status_code == 200
        found = (await api.http.get(f"/v1/sessions/{session_id}/motion")).json()
    assert 0.5 < found["probability"] <= 0.62
    assert any("in no frame is it sure" in warning for warning in found["warnings"])

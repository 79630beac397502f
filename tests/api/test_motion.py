"""`GET …/motion`: how the object of a session turned, from what the frames said."""

from dataclasses import replace
from typing import ClassVar

import numpy as np
import pytest
from api_client import running
from fake_worker import CUBE, FakeWorker

from service.client import AsyncClient
from service.inference.belief import Belief
from service.inference.pose import exp_so3, multiply, rotation_matrices
from service.inference.state import Poses

pytestmark = pytest.mark.anyio
RATE = np.deg2rad([3.0, -1.0, 2.0])
CAMERA = {"ra_deg": 120.0, "dec_deg": 20.0, "position_angle_deg": 15.0}


class Turning(FakeWorker):
    """Tells of a body that turns at ``RATE``, half a degree off in each frame and sure of that."""

    jobs: ClassVar[list] = []

    def track(self, job):
        rng = np.random.default_rng(job.frame_index)
        turn = exp_so3(RATE * 0.5 * job.frame_index)[None]
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
        found = (await api.http.get(here)).json()
        assert (await api.http.get(here)).json() == found
        assert len(Turning.jobs) == 2  # the refused one, and one for both answers
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


async def test_without_a_camera_rates_are_against_the_image(make_app):
    async with running(make_app(Turning)) as api:
        session_id = await api.ready_session(CUBE)
        for n in range(4):
            await api.post(session_id, n, time=f"2026-11-20T03:04:{5 + n / 2:09.6f}Z")
        found = (await api.http.get(f"/v1/sessions/{session_id}/motion")).json()
    assert found["relative_to"] == "camera"
    assert found["axis_gcrf"] is None
    assert any("camera" in warning for warning in found["warnings"])
    assert vector(found["sigma_deg_s"]).max() > 0.1  # four frames tell little


def vector(axes: dict[str, float]) -> np.ndarray:
    return np.array([axes[name] for name in "xyz"])

"""`/v1/objects`: what several sessions are of, and its motion as all telescopes of a pass saw it."""

from dataclasses import replace
from datetime import UTC, datetime, timedelta

import numpy as np
import pytest
from api_client import Api, running
from fake_worker import CUBE, FakeWorker
from test_report import Page

from service.attitude.camera import equatorial_camera
from service.client import AsyncClient
from service.inference.belief import Belief
from service.inference.pose import conjugate, exp_so3, from_matrices, multiply, rotation_matrices
from service.inference.state import Poses
from service.report.sentences import with_sigma
from service.sessions.objects import passes_of

pytestmark = pytest.mark.anyio
RATE = np.deg2rad([3.0, -1.0, 2.0])
START = datetime(2026, 11, 20, 3, 4, tzinfo=UTC)
HERE = {"ra_deg": 120.0, "dec_deg": 20.0, "position_angle_deg": 15.0}
THERE = {"ra_deg": 150.0, "dec_deg": -10.0, "position_angle_deg": -60.0}


def camera(pointing: dict[str, float]) -> np.ndarray:
    """(4,) camera -> GCRF."""
    return from_matrices(equatorial_camera(*pointing.values()))


class Spinning(FakeWorker):
    """Tells of a body that spins at ``RATE`` among the stars, half a degree off in each frame and sure of that."""

    camera, late_s, seed, off_deg = camera(HERE), 0.0, 0, 0.5

    def track(self, job):
        rng = np.random.default_rng([self.seed, job.frame_index])
        fixed = exp_so3(RATE * (job.time_s + self.late_s))[None]
        seen = multiply(fixed, exp_so3(np.deg2rad(self.off_deg) * rng.normal(size=(1, 3))))
        turn = multiply(conjugate(self.camera)[None], seen)
        pose = Poses(turn, np.zeros((1, 2)), np.zeros(1), np.zeros((1, 0)))
        covariance = np.diag([2 * np.deg2rad(self.off_deg) ** 2] * 3 + [0.1] * 9)[None]
        belief = Belief(job.time_s, 1.0, np.zeros(1), pose, np.zeros((1, 6)), covariance, each=True)
        report = super().track(job)
        best = replace(report.estimate.best, quaternion=turn[0])
        return replace(report, estimate=replace(report.estimate, best=best), belief=belief)


async def watch(
    api: Api, pointing: dict[str, float] | None, late_s: float = 0.0, frames: int = 20, data: bytes = CUBE
) -> str:
    """A telescope's session of the spinning body."""
    Spinning.camera, Spinning.late_s = camera(pointing or HERE), late_s
    Spinning.seed += 1
    session_id = await api.ready_session(data)
    for n in range(frames):
        time = (START + timedelta(seconds=late_s + n / 2)).isoformat()
        answer = await api.post(session_id, n, time=time, **(pointing or {}))
        assert answer.status_code == 200, answer.text
    return session_id


async def test_telescopes_of_one_pass_tell_one_motion(make_app):
    async with running(make_app(Spinning)) as api:
        first, second = await watch(api, HERE), await watch(api, THERE, late_s=3.3)
        later = await watch(api, HERE, late_s=86_400.0)
        async with AsyncClient("http://127.0.0.1", transport=api.http._transport) as client:
            made = await client.create_object("a box", [first, later])
            joined = await client.join_object(made.object_id, second)
            assert await client.join_object(made.object_id, second) == joined  # once more changes nothing
            assert joined.sessions == [first, second, later]
            found = await client.object_motion(made.object_id, 0)
            newest = await client.object_motion(made.object_id)
            alone = await client.motion(first)
        beyond = await api.http.get(f"/v1/objects/{made.object_id}/motion", params={"pass": 2})
        passes = (await api.http.get(f"/v1/objects/{made.object_id}/passes")).json()["passes"]
    assert (found.sessions, found.number, found.passes) == ([first, second], 0, 2)
    assert (newest.sessions, newest.number) == ([later], 1)
    assert [one["sessions"] for one in passes] == [[first, second], [later]]
    assert (passes[0]["start"], passes[0]["end"]) == ("2026-11-20T03:04:00.000Z", "2026-11-20T03:04:12.800Z")
    assert found.relative_to == "GCRF"
    assert (found.frames.stored, found.frames.used, found.frames.explained) == (40, 40, 1.0)
    # They go on where the first one stops: what both saw is a third longer, and the rate so much better known.
    assert found.span_s == pytest.approx(9.5 + 3.3)
    rate = np.array([getattr(found.angular_velocity_body_deg_s, k) for k in "xyz"])
    sigma = np.array([getattr(found.sigma_deg_s, k) for k in "xyz"])
    assert np.all(np.abs(rate - np.rad2deg(RATE)) < 5 * sigma)
    assert np.all(sigma < 0.8 * np.array([getattr(alone.sigma_deg_s, k) for k in "xyz"]))
    q = np.array([getattr(found.orientation, k) for k in "wxyz"])
    middle = (datetime.fromisoformat(found.epoch) - START).total_seconds()
    off = rotation_matrices(q).T @ rotation_matrices(exp_so3(RATE * middle))
    assert np.rad2deg(np.arccos((np.trace(off) - 1) / 2)) < 4 * found.orientation_sigma_deg < 4 * 0.3
    assert beyond.status_code == 404


async def test_the_spin_over_passes(make_app, monkeypatch):
    """Turns are counted from orbit to orbit and not over ten days; a pass without turning is left out by name."""
    monkeypatch.setattr(Spinning, "off_deg", 0.02)
    starts = [0.0, 5_800.0, 11_700.0, 864_000.0]
    async with running(make_app(Spinning)) as api:
        sessions = [await watch(api, HERE if k % 2 else THERE, late_s=late_s) for k, late_s in enumerate(starts)]
        short = await watch(api, HERE, late_s=2 * 86_400.0, frames=2)
        async with AsyncClient("http://127.0.0.1", transport=api.http._transport) as client:
            made = await client.create_object("a box", [*sessions, short])
            found = await client.object_spin(made.object_id)
            page = Page((await client.object_report(made.object_id)).decode())
            alone = (await client.create_object("<i>once</i>", sessions[:1])).object_id
        refused = await api.http.get(f"/v1/objects/{alone}/spin")
        unknown = await api.http.get(f"/v1/objects/{alone}/report")
        empty = (await api.http.post("/v1/objects", json={"name": "unseen"})).json()["object_id"]
        assert (await api.http.get(f"/v1/objects/{empty}/report")).status_code == 409
    rate = float(np.linalg.norm(np.rad2deg(RATE)))
    assert [one.number for one in found.passes] == [0, 1, 2, 4]
    assert [one.number for one in found.left_out] == [3]
    assert "3 frames" in found.left_out[0].reason
    turns = [one.turns_since_last for one in found.passes]
    assert turns[0] is turns[3] is None
    np.testing.assert_allclose(turns[1:3], [rate * 5_800 / 360, rate * 5_900 / 360], atol=0.01)
    assert found.rate_deg_s == pytest.approx(rate, abs=5 * found.rate_sigma_deg_s)
    assert found.rate_sigma_deg_s < 0.3 * min(one.rate_sigma_deg_s for one in found.passes)
    assert found.period_s == pytest.approx(360 / found.rate_deg_s)
    assert abs(found.period_change_s_per_day) < 4 * found.period_change_sigma_s_per_day
    axis = [getattr(found.axis_gcrf, name) for name in "xyz"]
    np.testing.assert_allclose(axis, RATE / np.linalg.norm(RATE), atol=0.01)
    assert not {"script", "link", "iframe"} & set(page.tags) and page.targets == []
    assert f"It turns once in {with_sigma(found.period_s, found.period_sigma_s)} s" in page.text
    assert "no change of the period is seen" in page.text and "pass 3" in page.text
    assert found.left_out[0].reason in page.text and page.tags.count("svg") == 3
    assert unknown.headers["content-security-policy"].startswith("sandbox; default-src 'none'")
    known = Page(unknown.text)
    assert "i" not in known.tags and "<i>once</i>" in known.text
    assert f"not known: {refused.json()['detail']}" in known.text
    assert found.warnings[0] == "turns cannot be counted over 1 of 3 gaps: rates alone tell of these"
    assert (refused.status_code, refused.json()["passes"]) == (409, 1)


async def test_what_cannot_be_told_in_one_is_refused(make_app):
    async with running(make_app(Spinning)) as api:
        first, blind = await watch(api, HERE, frames=4), await watch(api, None, frames=4)
        made = (await api.http.post("/v1/objects", json={"name": "x", "sessions": [first]})).json()
        path = f"/v1/objects/{made['object_id']}"
        assert (await api.http.get(f"{path}/motion")).status_code == 200
        await api.http.put(f"{path}/sessions/{blind}")
        refused = await api.http.get(f"{path}/motion")
        assert (refused.status_code, refused.json()["session"]) == (409, blind)
        assert (await api.http.delete(f"{path}/sessions/{blind}")).status_code == 204
        assert (await api.http.delete(f"{path}/sessions/{blind}")).status_code == 404
        longer = await watch(api, HERE, frames=4, data=CUBE + b"2")
        await api.http.put(f"{path}/sessions/{longer}")
        refused = await api.http.get(f"{path}/motion")
        assert (refused.status_code, refused.json()["session"]) == (409, longer)


async def test_objects_are_their_tenants_and_outlive_their_sessions(make_app):
    async with running(make_app(Spinning)) as api:
        session_id = await watch(api, HERE, frames=1)
        made = (await api.http.post("/v1/objects", json={"name": "x", "sessions": [session_id, session_id]})).json()
        assert made["sessions"] == [session_id]
        path = f"/v1/objects/{made['object_id']}"
        assert (await api.http.get("/v1/objects")).json() == {"objects": [made], "damaged": [], "next": None}
        assert (await api.http.delete(f"/v1/sessions/{session_id}")).status_code == 204
        assert (await api.http.get(path)).json()["sessions"] == []
        assert (await api.http.get(f"{path}/motion")).status_code == 409
        assert (await api.http.put(f"{path}/sessions/{session_id}")).status_code == 404
        unknown = await api.http.post("/v1/objects", json={"name": "y", "sessions": ["none"]})
        assert (unknown.status_code, len((await api.http.get("/v1/objects")).json()["objects"])) == (404, 1)
        assert (await api.http.delete(path)).status_code == 204
        assert (await api.http.get(path)).status_code == 404


def test_a_pass_ends_where_nobody_sees_the_object_for_half_an_hour():
    def seen(name: str, first: float, last: float):
        return name, (START + timedelta(minutes=first), START + timedelta(minutes=last))

    # The long one spans the gap between those that it holds.
    found = passes_of([seen("d", 80, 85), seen("b", 5, 40), seen("a", 0, 6), seen("c", 60, 61), seen("e", 115, 120)])
    assert [[name for name, _ in one] for one in found] == [["a", "b", "c", "d"], ["e"]]

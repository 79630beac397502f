"""Frames in: order, exactly once, refusals that change nothing."""

import asyncio

import pytest
from api_client import PNG, image, running
from fake_worker import CUBE, SlowWorker

from service.api.schemas import Estimate

pytestmark = pytest.mark.anyio


async def test_frame_gives_estimate_of_the_contract(api):
    session_id = await api.ready_session(CUBE + b"joint", joints={"free": ["panel"]})
    answer = await api.post(session_id, 1, time="2026-11-20T03:04:05.678Z")
    assert answer.status_code == 200
    body = answer.json()
    Estimate.model_validate(body)
    assert (body["index"], body["time"], body["duplicate"]) == (0, "2026-11-20T03:04:05.678Z", False)
    assert body["spread"]["covariance_order"][-1] == "joint:panel"
    assert set(body["best"]["joints"]) == {"panel"}
    assert body["best"]["orientation"]["w"] >= 0


async def test_frames_keep_their_order(api):
    session_id = await api.ready_session()
    answers = await asyncio.gather(*(api.post(session_id, n) for n in range(8)))
    assert [answer.json()["index"] for answer in answers] == list(range(8))


async def test_put_is_exactly_once(api):
    session_id = await api.ready_session()
    first = await api.put(session_id, 0, 1)
    again = await api.put(session_id, 0, 1)
    assert first.json() == {**again.json(), "duplicate": False}
    assert again.json()["duplicate"] is True
    other = await api.put(session_id, 0, 2)
    assert (other.status_code, other.json()["type"]) == (409, "urn:skypose:problem:frame-conflict")
    gap = await api.put(session_id, 2, 2)
    assert (gap.status_code, gap.json()["expected"]) == (409, 1)
    assert (await api.put(session_id, 1, 2)).status_code == 200


async def test_idempotency_key_is_exactly_once(api):
    session_id = await api.ready_session()
    key = {"Idempotency-Key": "a"}
    first = await api.post(session_id, 1, key)
    again = await api.post(session_id, 1, key)
    assert again.json() == {**first.json(), "duplicate": True}
    other = await api.post(session_id, 2, key)
    assert (other.status_code, other.json()["type"]) == (422, "urn:skypose:problem:idempotency-key-reused")
    assert (await api.post(session_id, 1)).json()["index"] == 1  # without a key the same bytes are a new frame


async def test_background_with_a_key_counts_once(api):
    session_id = await api.session()
    url, headers = f"/v1/sessions/{session_id}/background", {**PNG, "Idempotency-Key": "b0"}
    for _ in range(2):
        answer = await api.http.post(url, content=image(1), headers=headers)
        assert answer.json() == {"background_frames": 1, "state": "ready"}
    assert (await api.http.post(url, content=image(2), headers=headers)).status_code == 422
    assert (await api.http.post(url, content=image(2), headers=PNG)).json()["background_frames"] == 2


@pytest.mark.parametrize(
    ("change", "status", "slug"),
    [
        ({"headers": {"Content-Type": "text/plain"}}, 415, "unsupported-media-type"),
        ({"content": image(1)[:-40]}, 422, "broken-image"),
        ({"content": b""}, 422, "invalid-input"),
        ({"content": image(1, (8, 16))}, 422, "image-mismatch"),
        ({"params": {"time": "yesterday"}}, 422, "invalid-input"),
        ({"params": {"time": "2026-11-20T03:04:05"}}, 422, "invalid-input"),
        ({"params": {"colour": "red"}}, 422, "invalid-input"),
        ({"params": {"ra_deg": "nan"}}, 422, "invalid-input"),
        ({"headers": {**PNG, "Idempotency-Key": "x" * 256}}, 422, "invalid-input"),
        ({"content": b"x" * 1_100_000}, 413, "too-large"),
    ],
)
async def test_bad_frame_changes_nothing(make_app, change, status, slug):
    async with running(make_app(max_frame_mb=1)) as api:
        session_id = await api.ready_session()
        await api.post(session_id, 1)
        before = (await api.http.get(f"/v1/sessions/{session_id}")).json()
        call = {"content": image(2), "headers": PNG, **change}
        answer = await api.http.post(f"/v1/sessions/{session_id}/frames", **call)
        assert (answer.status_code, answer.json()["type"]) == (status, f"urn:skypose:problem:{slug}"), answer.text
        assert answer.headers["content-type"] == "application/problem+json"
        assert answer.json()["field"]
        assert (await api.http.get(f"/v1/sessions/{session_id}")).json() == before
        assert (await api.post(session_id, 2)).json()["index"] == 1


async def test_frame_before_background_and_unknown_session(api):
    session_id = await api.session()
    answer = await api.post(session_id, 1)
    assert (answer.status_code, answer.json()["type"]) == (409, "urn:skypose:problem:no-background")
    assert (await api.post("nobody", 1)).status_code == 404


async def test_time_must_not_run_backwards(api):
    session_id = await api.ready_session()
    await api.post(session_id, 1, time="2026-11-20T03:00:10Z")
    answer = await api.post(session_id, 2, time="2026-11-20T03:00:09Z")
    assert (answer.status_code, answer.json()["field"]) == (422, "time")
    moved = await api.post(session_id, 2, time="2026-11-20T04:00:12.5+01:00")
    assert moved.json()["log_evidence"] == -2.5  # the fake reports the filter's clock there
    assert moved.json()["time"] == "2026-11-20T03:00:12.500Z"


async def test_filter_clock_does_not_depend_on_arrival(api):
    session_id = await api.ready_session(motion={"frame_interval_s": 0.25})
    clocks = [-(await api.post(session_id, n)).json()["log_evidence"] for n in range(3)]
    assert clocks == [0.0, 0.25, 0.5]


async def test_full_inbox_is_refused_with_retry_after(make_app):
    async with running(make_app(SlowWorker, session_inbox_frames=2)) as api:
        session_id = await api.ready_session()
        answers = await asyncio.gather(*(api.post(session_id, n) for n in range(12)))
        refused = [answer for answer in answers if answer.status_code == 429]
        assert refused and all(answer.headers["retry-after"] == "1" for answer in refused)
        taken = [answer.json()["index"] for answer in answers if answer.status_code == 200]
        assert sorted(taken) == list(range(len(taken)))


async def test_frames_of_all_sessions_together_are_bounded(make_app):
    async with running(make_app(SlowWorker, max_waiting_frames=3)) as api:
        sessions = [await api.ready_session() for _ in range(6)]
        answers = await asyncio.gather(*(api.post(session_id, 1) for session_id in sessions))
        assert sorted({answer.status_code for answer in answers}) == [200, 503]
        refused = next(answer for answer in answers if answer.status_code == 503)
        assert refused.json()["setting"] == "SKYPOSE_MAX_WAITING_FRAMES"
        assert [(await api.post(session_id, 2)).status_code for session_id in sessions] == [200] * 6


async def test_pending_bytes_are_bounded(make_app):
    async with running(make_app(SlowWorker, max_pending_mb=1, session_inbox_frames=100)) as api:
        session_id = await api.ready_session()
        body = image(1) + b"\0" * 600_000 + image(1)[-8:]
        url = f"/v1/sessions/{session_id}/frames"
        answers = await asyncio.gather(*(api.http.post(url, content=body, headers=PNG) for _ in range(4)))
        assert sorted({answer.status_code for answer in answers}) == [200, 503]


async def test_respond_async(make_app):
    async with running(make_app(SlowWorker)) as api:
        session_id = await api.ready_session()
        answer = await api.post(session_id, 1, {"Prefer": "respond-async"})
        assert (answer.status_code, answer.headers["preference-applied"]) == (202, "respond-async")
        while (found := await api.http.get(answer.headers["location"])).status_code == 202:
            pass
        assert (found.status_code, found.json()["index"]) == (200, 0)
        bad = await api.http.post(
            f"/v1/sessions/{session_id}/frames",
            content=b"junk",
            headers={**PNG, "Prefer": "respond-async", "Idempotency-Key": "a/b?"},
        )
        while (found := await api.http.get(bad.headers["location"])).status_code == 202:
            pass
        assert found.json()["type"] == "urn:skypose:problem:broken-image"


async def test_a_time_out_of_all_bounds_is_refused_and_changes_nothing(api):
    session_id = await api.ready_session()
    for wrong in ("9999-12-31T23:59:59-23:59", "2300-01-01T00:00:00Z"):
        answer = await api.post(session_id, 1, time=wrong)
        assert (answer.status_code, answer.json()["field"]) == (422, "time"), answer.text
    assert (await api.post(session_id, 1, time="2026-11-20T03:00:00Z")).json()["index"] == 0

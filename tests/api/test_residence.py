"""Sessions leave memory when idle and come back as they were; a newer owner shuts an older one out."""

import asyncio

import pytest
from api_client import running
from fake_worker import SlowWorker

from service.store import sessions

pytestmark = pytest.mark.anyio


def comparable(estimate: dict) -> dict:
    return {key: estimate[key] for key in estimate if key not in ("time", "timing_ms", "session_id")}


async def test_evicted_session_goes_on_as_if_it_had_stayed(make_app, tmp_path):
    async with running(make_app(data_dir=tmp_path / "calm")) as calm:
        session_id = await calm.ready_session()
        expected = [comparable((await calm.post(session_id, n)).json()) for n in range(4)]
    app = make_app(session_idle_s=1e-9)
    registry = app.state.services.registry
    async with running(app) as api:
        session_id = await api.ready_session()
        for n in range(4):
            assert comparable((await api.post(session_id, n)).json()) == expected[n]
            registry.evict()
            assert not registry.resident


async def test_longest_idle_leave_first_past_the_number(make_app):
    app = make_app(max_resident_sessions=2)
    registry = app.state.services.registry
    async with running(app) as api:
        ids = [await api.ready_session() for _ in range(4)]
        await api.post(ids[0], 1)
        registry.evict()
        assert set(registry.resident) == {ids[0], ids[3]}


async def test_busy_session_stays(make_app):
    app = make_app(SlowWorker, session_idle_s=1e-9)
    registry = app.state.services.registry
    async with running(app) as api:
        session_id = await api.ready_session()
        posted = asyncio.create_task(api.post(session_id, 1))
        while session_id not in registry.resident or registry.resident[session_id].inbox.idle:
            await asyncio.sleep(0)
        assert registry.evict() == 0
        assert (await posted).status_code == 200


@pytest.mark.usefixtures("one_process")
async def test_owner_that_was_overtaken_writes_nothing_and_is_replaced(make_app):
    app = make_app()
    async with running(app) as api:
        session_id = await api.ready_session()
        await api.post(session_id, 1)
        await app.state.services.archive.database.write(sessions.claim, session_id)  # as another process would
        refused = await api.post(session_id, 2)
        assert (refused.status_code, refused.json()["type"]) == (503, "urn:skypose:problem:owner-changed")
        assert (await api.post(session_id, 2)).json()["index"] == 1


@pytest.mark.usefixtures("one_process")  # on PostgreSQL several commit at once, in any order
async def test_sessions_share_the_worker_fairly(make_app):
    """Sixteen sessions with all their frames posted at once: none gets far ahead of the others."""
    async with running(make_app(session_inbox_frames=10)) as api:
        ids = [await api.ready_session() for _ in range(16)]
        order: list[str] = []

        async def post(session_id: str, n: int) -> None:
            assert (await api.post(session_id, n)).status_code == 200
            order.append(session_id)

        await asyncio.gather(*(post(session_id, n) for session_id in ids for n in range(6)))
        halfway = [order[: len(order) // 2].count(session_id) for session_id in ids]
        assert max(halfway) - min(halfway) <= 2, halfway
        for session_id in ids:
            found = (await api.http.get(f"/v1/sessions/{session_id}/estimates")).json()["estimates"]
            assert [estimate["index"] for estimate in found] == list(range(6))

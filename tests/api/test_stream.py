"""The live stream loses and repeats nothing, whatever is cut."""

import asyncio
import json
import os
import random

import httpx
import pytest
import websockets
from api_client import Api, served
from fake_worker import SlowWorker

pytestmark = pytest.mark.anyio


async def read(socket, count: int) -> list[dict]:
    return [json.loads(await socket.recv()) for _ in range(count)]


async def test_stream_replays_and_follows(make_app):
    async with served(make_app()) as address, httpx.AsyncClient(base_url=f"http://{address}") as http:
        api = Api(http)
        session_id = await api.ready_session()
        before = [(await api.post(session_id, n)).json() for n in range(3)]
        async with websockets.connect(f"ws://{address}/v1/sessions/{session_id}/stream?after=1") as socket:
            assert await read(socket, 2) == [{"type": "estimate", "seq": n + 1, "estimate": before[n]} for n in (1, 2)]
            live = (await api.post(session_id, 3)).json()
            assert await read(socket, 1) == [{"type": "estimate", "seq": 4, "estimate": live}]
            await http.delete(f"/v1/sessions/{session_id}")
            assert await read(socket, 1) == [{"type": "end", "seq": 4, "reason": "deleted"}]


async def test_stream_of_unknown_session_is_denied(make_app):
    async with served(make_app()) as address:
        with pytest.raises(websockets.InvalidStatus) as refusal:
            await websockets.connect(f"ws://{address}/v1/sessions/x/stream")
        assert refusal.value.response.status_code == 404
        with pytest.raises(websockets.InvalidStatus) as refusal:
            await websockets.connect(f"ws://{address}/v1/sessions/x/stream?after=one")
        assert refusal.value.response.status_code == 422


async def test_silent_stream_beats(make_app):
    async with served(make_app(stream_heartbeat_s=0.01)) as address:
        async with httpx.AsyncClient(base_url=f"http://{address}") as http:
            session_id = await Api(http).session()
        async with websockets.connect(f"ws://{address}/v1/sessions/{session_id}/stream") as socket:
            assert await read(socket, 2) == [{"type": "heartbeat", "seq": 0}] * 2


async def test_cursor_ahead_of_the_log_must_resync(make_app):
    async with served(make_app()) as address, httpx.AsyncClient(base_url=f"http://{address}") as http:
        session_id = await Api(http).ready_session()
        await Api(http).post(session_id, 1)
        async with websockets.connect(f"ws://{address}/v1/sessions/{session_id}/stream?after=99") as socket:
            assert await read(socket, 1) == [{"type": "resync-required", "seq": 1}]


async def test_events_carry_the_same_and_resume(make_app):
    async with served(make_app()) as address, httpx.AsyncClient(base_url=f"http://{address}") as http:
        api = Api(http)
        session_id = await api.ready_session()
        sent = [(await api.post(session_id, n)).json() for n in range(3)]
        url = f"/v1/sessions/{session_id}/events"
        async with http.stream("GET", url, params={"after": 0}, headers={"Last-Event-ID": "1"}) as answer:
            assert answer.headers["content-type"].startswith("text/event-stream")
            lines = answer.aiter_lines()
            got = [[await anext(lines) for _ in range(4)] for _ in range(2)]
        assert [event[0] for event in got] == ["id: 2", "id: 3"]
        assert [json.loads(event[2].removeprefix("data: "))["estimate"] for event in got] == sent[1:]


async def test_watcher_that_left_is_forgotten(make_app):
    app = make_app()
    async with served(app) as address, httpx.AsyncClient(base_url=f"http://{address}") as http:
        session_id = await Api(http).session()
        hub = app.state.services.hub
        here = f"{address}/v1/sessions/{session_id}"
        async with websockets.connect(f"ws://{here}/stream"), http.stream("GET", f"http://{here}/events"):
            assert hub.watchers == 2
        async with asyncio.timeout(10):
            while hub.watchers:
                await asyncio.sleep(0)


async def test_too_many_watchers_are_refused(make_app):
    async with served(make_app(max_streams=1)) as address, httpx.AsyncClient(base_url=f"http://{address}") as http:
        session_id = await Api(http).session()
        async with websockets.connect(f"ws://{address}/v1/sessions/{session_id}/stream"):
            answer = await http.get(f"/v1/sessions/{session_id}/events")
            assert (answer.status_code, answer.json()["setting"]) == (503, "SKYPOSE_MAX_STREAMS")


async def test_cut_at_random_loses_and_repeats_nothing(make_app, anyio_backend):
    """Watchers that are cut after a random number of messages, and resume after the last one they saw.

    The long form: SKYPOSE_TEST_STREAM_FRAMES=700 (about 1,000 cuts).
    """
    n_frames = int(os.environ.get("SKYPOSE_TEST_STREAM_FRAMES", "60"))
    dice = random.Random(1)
    async with served(make_app(SlowWorker, stream_ring_events=4)) as address:  # noqa: SIM117
        async with httpx.AsyncClient(base_url=f"http://{address}", timeout=60) as http:
            api = Api(http)
            session_id = await api.ready_session()

            cuts = 0

            async def watch() -> list[int]:
                nonlocal cuts
                seen: list[int] = []
                while len(seen) < n_frames:
                    after = seen[-1] if seen else 0
                    url = f"ws://{address}/v1/sessions/{session_id}/stream?after={after}"
                    async with websockets.connect(url) as socket:
                        for message in await read(socket, min(dice.randint(1, 3), n_frames - len(seen))):
                            assert message["estimate"]["index"] == message["seq"] - 1
                            seen.append(message["seq"])
                        socket.transport.abort()
                        cuts += 1
                return seen

            watchers = [asyncio.create_task(watch()) for _ in range(3)]
            for n in range(n_frames):
                assert (await api.post(session_id, n)).status_code == 200
            for watcher in watchers:
                assert await watcher == list(range(1, n_frames + 1))
            print(f"{cuts} cuts, every event once")

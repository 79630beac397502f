"""Both clients through a real port: a pass, its files, and streams that survive a restart of the service."""

import asyncio
from contextlib import aclosing
from pathlib import Path

import numpy as np
import pytest
from api_client import image, served
from callers import guarded_server
from fake_worker import CUBE

from service.client import AsyncClient, Client, RefusedError

pytestmark = pytest.mark.anyio
CAMERA = {"up_angle_deg": 20.0}


def whole_pass(url: str, folder: Path) -> str:
    """What a script does, with the sync client; in a thread of its own."""
    with Client(url) as client:
        model = client.upload_model(CUBE + b"joint", file_name="sat.glb", name="sat")
        assert [item.model_id for item in client.models()] == [model.model_id]
        session = client.create_session(model.model_id, name="pass", camera=CAMERA, joints={"free": "all"})
        client.add_background(session.session_id, image(), "image/png")
        path = folder / "frame.png"
        path.write_bytes(image(1))
        first = client.put_frame(session.session_id, 0, path, ra_deg=10.0, dec_deg=20.0)
        assert client.put_frame(session.session_id, 0, path).duplicate
        assert first.best.attitude is not None
        np.save(folder / "stack.npy", np.random.default_rng(0).integers(0, 255, (3, 16, 16), dtype=np.uint8))
        told = list(client.track_file(session.session_id, folder / "stack.npy", index=1))
        assert [item.index for item in told] == [1, 2, 3]
        reads(client, session.session_id)
        with pytest.raises(RefusedError, match="frame-gap"):
            client.put_frame(session.session_id, 9, path)
        blob = client.checkpoint(session.session_id)
        client.delete_session(session.session_id)
        assert client.put_checkpoint(session.session_id, blob).frames == 4
        assert next(client.sessions()).name == "pass"
        return session.session_id


def reads(client: Client, session_id: str) -> None:
    """Every call that reads."""
    assert [item.index for item in client.estimates(session_id, after=0)] == [1, 2, 3]
    assert client.estimate(session_id).index == 3
    assert client.overlay(session_id, 0)[1:4] == b"PNG"
    assert client.particles(session_id)["orientation"].shape[1] == 4
    assert client.export(session_id).count(b"\n") == 5
    for over in ("websocket", "sse"):
        events = client.watch(session_id, after=2, over=over)
        assert [next(events).seq for _ in range(2)] == [3, 4]
        events.close()
    assert client.system().sessions == 1


async def test_a_pass_with_each_client(make_app, tmp_path):
    async with served(make_app()) as host:
        session_id = await asyncio.to_thread(whole_pass, f"http://{host}", tmp_path)
        async with AsyncClient(f"http://{host}") as client:
            answer = await client.post_frame(session_id, image(7), "image/png", key="seven")
            assert (await client.post_frame(session_id, image(7), "image/png", key="seven")).duplicate
            assert (await client.estimate(session_id)).best == answer.best


async def test_a_folder_in_one_call(make_app, tmp_path):
    (tmp_path / "cube.glb").write_bytes(CUBE + b"joint")
    folder = tmp_path / "frames"
    folder.mkdir()
    np.save(folder / "b.npy", np.random.default_rng(0).integers(0, 255, (2, 16, 16), dtype=np.uint8))
    (folder / "a.png").write_bytes(image(1))
    (folder / "truth.csv").write_text("frame")

    def sync(url: str) -> list[int]:
        with Client(url) as client:
            told = list(client.track(str(tmp_path / "cube.glb"), str(folder), name="evening", joints={"free": "all"}))
            assert client.session(told[0].session_id).name == "evening"
            with pytest.raises(FileNotFoundError, match="no image"):
                next(client.track(tmp_path / "cube.glb", tmp_path))
            return [one.index for one in told]

    async with served(make_app()) as host:
        assert await asyncio.to_thread(sync, f"http://{host}") == [0, 1, 2]
        async with AsyncClient(f"http://{host}") as client:
            told = [one async for one in client.track(tmp_path / "cube.glb", folder)]
            assert [one.index for one in told] == [0, 1, 2] and told[0].best.joints == {}


@pytest.mark.parametrize("over", ["websocket", "sse"])
async def test_the_key_goes_with_every_call_and_stream(make_app, tmp_path, over):
    async with guarded_server(make_app, tmp_path) as callers:
        url = f"http://{callers.address}"
        async with AsyncClient(url, api_key=await callers.key("acme", "operate")) as client:
            model = await client.upload_model(CUBE, file_name="sat.glb")
            session_id = (await client.create_session(model.model_id)).session_id
            await client.add_background(session_id, image(), "image/png")
            await client.put_frame(session_id, 0, image(1), "image/png")
            async with aclosing(client.watch(session_id, after=0, over=over)) as events:
                assert (await anext(events)).seq == 1
        async with AsyncClient(url) as stranger, aclosing(stranger.watch(session_id, after=0, over=over)) as events:
            with pytest.raises(RefusedError) as caught:
                await anext(events)
            assert caught.value.status == 401


@pytest.mark.parametrize("over", ["websocket", "sse"])
async def test_a_stream_survives_a_restart(make_app, over):
    """Every event once and in order, though the service stops in the middle and comes back."""
    seen, back, heard = [], asyncio.Event(), asyncio.Event()

    async def follow(client: AsyncClient, session_id: str) -> None:
        async for event in client.watch(session_id, after=0, over=over):
            if event.type == "end":
                return
            seen.append(event.estimate.index)
            heard.set()

    async def wait_for_service(_: float) -> None:
        await back.wait()

    async with served(make_app()) as host:
        watcher = AsyncClient(f"http://{host}", sleep=wait_for_service)
        client = AsyncClient(f"http://{host}")
        model = await client.upload_model(CUBE, file_name="sat.glb")
        session_id = (await client.create_session(model.model_id)).session_id
        await client.add_background(session_id, image(), "image/png")
        for k in range(2):
            await client.put_frame(session_id, k, image(k), "image/png")
        following = asyncio.create_task(follow(watcher, session_id))
        await heard.wait()
    async with served(make_app(), int(host.rpartition(":")[2])):
        back.set()
        for k in range(2, 4):
            await client.put_frame(session_id, k, image(k), "image/png")
        while len(seen) < 4:
            await asyncio.sleep(0)
        await client.delete_session(session_id)
        await following
        await asyncio.gather(watcher.aclose(), client.aclose())
    assert seen == [0, 1, 2, 3]

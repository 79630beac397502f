"""A session moves to another server and goes on there as it would have here."""

import json
import struct
import zlib
from contextlib import asynccontextmanager
from dataclasses import replace

import numpy as np
import pytest
from api_client import running
from fake_worker import CUBE

from service.sessions.checkpoint import Checkpoint
from service.workers.codec import FORMAT_VERSION, decode, encode

pytestmark = pytest.mark.anyio
JOINTS = CUBE + b"joint"


def comparable(estimate: dict) -> dict:
    return {key: value for key, value in estimate.items() if key not in ("time", "timing_ms", "session_id")}


async def history(api, session_id: str) -> list[dict]:
    return [comparable(e) for e in (await api.http.get(f"/v1/sessions/{session_id}/estimates")).json()["estimates"]]


@asynccontextmanager
async def two_servers(make_app, tmp_path):
    async with running(make_app()) as one, running(make_app(data_dir=tmp_path / "other")) as two:
        yield one, two


async def checkpoint(api, session_id: str) -> bytes:
    answer = await api.http.get(f"/v1/sessions/{session_id}/checkpoint")
    assert answer.status_code == 200
    return answer.content


@pytest.mark.parametrize("name", [None, "other-name"])
async def test_session_goes_on_elsewhere(make_app, tmp_path, name):
    async with two_servers(make_app, tmp_path) as (one, two):
        session_id = await one.ready_session(JOINTS, joints={"free": "all"}, name="mine")
        for n in range(3):
            await one.post(session_id, n, {"Idempotency-Key": str(n)})
        there = name or session_id
        url = f"/v1/sessions/{there}/checkpoint"
        moved = await two.http.put(url, content=await checkpoint(one, session_id))
        assert (moved.status_code, moved.json()["frames"], moved.json()["name"]) == (201, 3, "mine")
        again = await two.post(there, 2, {"Idempotency-Key": "2"})
        assert again.json()["duplicate"] is True
        for n in range(3, 6):
            here, gone = await one.post(session_id, n), await two.post(there, n)
            assert comparable(here.json()) == comparable(gone.json())
            assert gone.json()["session_id"] == there
        assert await history(one, session_id) == await history(two, there)


async def test_later_stand_replaces_an_earlier_one_only(make_app, tmp_path):
    async with two_servers(make_app, tmp_path) as (one, two):
        session_id = await one.ready_session()
        url = f"/v1/sessions/{session_id}/checkpoint"
        blobs = [await checkpoint(one, session_id)]
        for n in range(2):
            await one.post(session_id, n)
            blobs.append(await checkpoint(one, session_id))
        assert [(await two.http.put(url, content=blob)).status_code for blob in blobs] == [201, 200, 200]
        assert (await two.http.put(url, content=blobs[2])).status_code == 200
        assert (await two.http.put(url, content=blobs[1])).status_code == 409
        await two.post(session_id, 77)
        await one.post(session_id, 2)
        assert (await two.http.put(url, content=await checkpoint(one, session_id))).status_code == 409
        assert (await two.http.get(f"/v1/sessions/{session_id}")).json()["frames"] == 3


async def test_session_without_frames_or_background_moves_too(make_app, tmp_path):
    async with two_servers(make_app, tmp_path) as (one, two):
        session_id = await one.session()
        blob = await checkpoint(one, session_id)
        assert (await two.http.put(f"/v1/sessions/{session_id}/checkpoint", content=blob)).status_code == 201
        assert (await two.post(session_id, 1)).json()["type"].endswith("no-background")


async def test_damage_and_other_versions_are_refused(api):
    session_id = await api.ready_session()
    await api.post(session_id, 1)
    blob = await checkpoint(api, session_id)
    before = (await api.http.get("/v1/sessions")).json()
    newer = blob[:4] + struct.pack("<H", FORMAT_VERSION + 1) + blob[6:-4]
    bad = [blob[:-1], blob[1:], b"x", blob[:100] + b"?" + blob[101:], newer + struct.pack("<I", zlib.crc32(newer))]
    for content in bad:
        answer = await api.http.put("/v1/sessions/new/checkpoint", content=content)
        assert (answer.status_code, answer.json()["type"]) == (422, "urn:skypose:problem:broken-checkpoint")
    assert (await api.http.put("/v1/sessions/a.b/checkpoint", content=blob)).status_code == 422
    assert (await api.http.get("/v1/sessions/x/checkpoint")).status_code == 404
    assert (await api.http.get("/v1/sessions")).json() == before


async def test_a_status_that_is_not_the_last_estimates_is_refused(api):
    session_id = await api.ready_session()
    await api.post(session_id, 1)
    packed = decode(Checkpoint, await checkpoint(api, session_id))
    history = json.loads(packed.history.tobytes())
    history["estimates"][-1]["document"]["status"] = "lost"
    forged = encode(replace(packed, history=np.frombuffer(json.dumps(history).encode(), np.uint8)))
    answer = await api.http.put("/v1/sessions/new/checkpoint", content=forged)
    assert (answer.status_code, "time or status" in answer.json()["detail"]) == (422, True), answer.text

"""Files of several frames: one estimate per frame, streamed, exactly once."""

import io
import struct
from datetime import UTC, datetime, timedelta

import numpy as np
import orjson
import pytest

from service.api.schemas import Estimate
from service.sessions.batch import frame_times

pytestmark = pytest.mark.anyio

STACK = np.random.default_rng(13).integers(0, 256, (4, 16, 16), dtype=np.uint8)
START = datetime(2026, 11, 20, 3, 4, 5, tzinfo=UTC)
NPY, SER = "application/x-npy", "video/x-ser"


def npy(stack) -> bytes:
    stream = io.BytesIO()
    np.save(stream, stack)
    return stream.getvalue()


def ser(stack, step_s: float) -> bytes:
    n, height, width = stack.shape
    header = struct.pack("<14s7i40s40s40s2q", b"LUCAM-RECORDER", 0, 0, 0, width, height, 8, n, b"", b"", b"", 0, 0)
    since = START - datetime(1, 1, 1, tzinfo=UTC)
    ticks = [(since + timedelta(seconds=step_s * k)) // timedelta(microseconds=1) * 10 for k in range(n)]
    return header + stack.tobytes() + struct.pack(f"<{n}q", *ticks)


async def send(api, path: str, body: bytes, media: str, method: str = "POST", **options):
    headers = {"Content-Type": media, **options.pop("headers", {})}
    return await api.http.request(method, path, content=body, headers=headers, **options)


def lines(answer) -> list[dict]:
    assert answer.status_code == 200, answer.text
    assert answer.headers["content-type"] == "application/x-ndjson"
    return [orjson.loads(line) for line in answer.content.splitlines()]


async def test_one_line_per_frame_with_the_files_times(api):
    session_id = await api.ready_session()
    answers = lines(await send(api, f"/v1/sessions/{session_id}/frames", ser(STACK, 2.0), SER))
    for answer in answers:
        Estimate.model_validate(answer)
    assert [answer["index"] for answer in answers] == [0, 1, 2, 3]
    assert [answer["time"][17:19] for answer in answers] == ["05", "07", "09", "11"]
    assert (await api.http.get(f"/v1/sessions/{session_id}/estimates/3/overlay.png")).status_code == 200


async def test_a_time_given_is_that_of_the_first_frame(api):
    session_id = await api.ready_session(motion={"frame_interval_s": 0.5})
    query = {"time": "2026-11-21T00:00:00Z"}
    answers = lines(await send(api, f"/v1/sessions/{session_id}/frames", npy(STACK), NPY, params=query))
    assert [answer["time"][17:21] for answer in answers] == ["00.0", "00.5", "01.0", "01.5"]


async def test_the_same_file_again_gives_the_same_answers(api):
    session_id = await api.ready_session()
    path = f"/v1/sessions/{session_id}/frames"
    first = lines(await send(api, f"{path}/0", npy(STACK), NPY, "PUT"))
    again = lines(await send(api, f"{path}/0", npy(STACK), NPY, "PUT"))
    assert [answer["duplicate"] for answer in again] == [True] * 4
    assert again == [{**answer, "duplicate": True} for answer in first]
    keyed = [lines(await send(api, path, npy(STACK), NPY, headers={"Idempotency-Key": "k"})) for _ in range(2)]
    assert [answer["index"] for answer in keyed[0]] == [answer["index"] for answer in keyed[1]] == [4, 5, 6, 7]


async def test_what_is_refused(api):
    session_id = await api.ready_session()
    path = f"/v1/sessions/{session_id}/frames"
    large = await send(api, path, npy(np.zeros((2, 8, 8), np.uint8)), NPY)
    assert (large.status_code, large.json()["type"]) == (422, "urn:skypose:problem:image-mismatch")
    waiting = await send(api, path, npy(STACK), NPY, headers={"Prefer": "respond-async"})
    assert (waiting.status_code, waiting.json()["field"]) == (422, "header:Prefer")
    junk = await send(api, path, b"junk", "video/mp4")
    assert (junk.status_code, junk.json()["type"]) == (422, "urn:skypose:problem:broken-image")
    single = await send(api, path, npy(STACK[:1]), NPY)
    assert single.json()["index"] == 0  # one frame: one document, as ever


async def test_times_past_the_calendar_are_refused(api):
    session_id = await api.ready_session()
    query, kind = {"time": "9999-12-31T23:59:59.999999Z"}, {"Content-Type": NPY}
    answer = await api.http.post(f"/v1/sessions/{session_id}/frames", content=npy(STACK), headers=kind, params=query)
    assert (answer.status_code, answer.json()["field"]) == (422, "time"), answer.text


async def test_a_later_refusal_is_the_last_line(api):
    session_id = await api.ready_session()
    path = f"/v1/sessions/{session_id}/frames"
    await send(api, f"{path}/0", npy(STACK[:1]), NPY, "PUT")
    answers = lines(await send(api, path, npy(STACK), NPY))
    assert answers[-1]["index"] == 4
    conflict = lines(await send(api, f"{path}/1", npy(np.concatenate([STACK[:1], STACK[2:]])), NPY, "PUT"))
    assert conflict[0]["duplicate"] is True
    assert conflict[-1]["type"] == "urn:skypose:problem:frame-conflict"


def test_times_of_frames():
    seconds = [timedelta(seconds=k) for k in (0, 2, 5)]
    stamps = [START + s for s in seconds]
    later = START + timedelta(hours=1)
    assert frame_times(None, stamps, 0.1) == tuple(stamps)
    assert frame_times(later, stamps, 0.1) == tuple(later + s for s in seconds)
    assert frame_times(later, [None] * 2, 0.5) == (later, later + timedelta(seconds=0.5))
    assert frame_times(None, [START, None], 0.5) == (START, START + timedelta(seconds=0.5))
    assert frame_times(None, [None] * 3, 0.1) == (None, None, None)

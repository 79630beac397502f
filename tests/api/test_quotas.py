"""What a key or a tenant may have is bounded, each refusal names its limit, and others are not touched."""

import asyncio
import io

import httpx
import numpy as np
import pytest
from api_client import PNG, Api, image, running, served
from callers import guarded
from fake_worker import CUBE, SlowWorker

pytestmark = pytest.mark.anyio


def limit_named(answer, setting: str, kind: str = "quota-exceeded", status: int = 429) -> None:
    assert (answer.status_code, answer.json()["type"]) == (status, f"urn:skypose:problem:{kind}"), answer.text
    assert answer.json()["setting"] == setting
    assert answer.json()["limit"]
    assert int(answer.headers["retry-after"]) >= 1


async def test_sessions_and_models_of_a_tenant(make_app, tmp_path):
    async with guarded(make_app, tmp_path, quota_sessions=2, quota_models=1) as callers:
        acme, other = await callers.client("acme"), await callers.client("other")
        first = await acme.session()
        model_id = (await acme.http.get(f"/v1/sessions/{first}")).json()["model_id"]
        await acme.session()  # the same model: not one more
        limit_named(await acme.http.post("/v1/sessions", json={"model_id": model_id}), "SKYPOSE_QUOTA_SESSIONS")
        limit_named(await acme.model(CUBE + b"2"), "SKYPOSE_QUOTA_MODELS")
        blob = (await acme.http.get(f"/v1/sessions/{first}/checkpoint")).content
        limit_named(await acme.http.put("/v1/sessions/new/checkpoint", content=blob), "SKYPOSE_QUOTA_SESSIONS")
        assert (await acme.http.put(f"/v1/sessions/{first}/checkpoint", content=blob)).status_code == 200
        await other.session(CUBE + b"2")
        assert (await acme.http.delete(f"/v1/sessions/{first}")).status_code == 204
        await acme.session()


async def test_particles_of_a_tenant(make_app, tmp_path):
    async with guarded(make_app, tmp_path, quota_particles=5000) as callers:
        acme = await callers.client("acme")
        await acme.session(filter={"particles": 3000})
        model_id = (await acme.http.get("/v1/models")).json()["models"][0]["model_id"]
        more = {"model_id": model_id, "filter": {"particles": 2001}}
        limit_named(await acme.http.post("/v1/sessions", json=more), "SKYPOSE_QUOTA_PARTICLES")
        await acme.session(filter={"particles": 2000})


async def test_rates_of_a_key(make_app, tmp_path):
    settings = {"rate_calls_per_s": 5, "rate_megabytes_per_s": 0.001, "rate_megapixels_per_s": 0.00001}
    async with guarded(make_app, tmp_path, **settings) as callers:
        setup = await callers.client("acme")
        session_id = await setup.session()
        here = f"/v1/sessions/{session_id}"
        sky = await callers.client("acme", "operate")
        assert (await sky.http.post(f"{here}/background", content=image(), headers=PNG)).status_code == 200
        limit_named(await sky.post(session_id, 1), "SKYPOSE_RATE_MEGAPIXELS_PER_S", "rate-limited")
        another = await callers.client("acme", "operate")
        assert (await another.http.post("/v1/sessions", content=b" " * 30000)).status_code == 422
        answer = await another.http.post("/v1/sessions", content=b" " * 10)
        limit_named(answer, "SKYPOSE_RATE_MEGABYTES_PER_S", "rate-limited")
        third = await callers.client("acme")
        answers = [await third.http.get("/v1/me") for _ in range(30)]
        limit_named(answers[-1], "SKYPOSE_RATE_CALLS_PER_S", "rate-limited")
        assert (await (await callers.client("acme")).http.get("/v1/me")).status_code == 200


async def test_rates_of_its_own(make_app, tmp_path):
    async with guarded(make_app, tmp_path) as callers:
        operator, acme = await callers.client("default"), await callers.client("acme")
        wanted = {"role": "read", "name": "slow", "rates": {"calls_per_s": 1}}
        for admin in (operator, acme):
            made = (await admin.http.post("/v1/keys", json=wanted)).json()
            assert made["rates"]["calls_per_s"] == 1
            slow = await callers.with_token(made["key"])
            answers = [await slow.http.get("/v1/me") for _ in range(8)]
            limit_named(answers[-1], "calls_per_s of the key", "rate-limited")
            listed = (await admin.http.get("/v1/keys")).json()["keys"]
            assert listed[-1]["rates"] == {"calls_per_s": 1}
        wanted["rates"] = {"calls_per_s": 1e6}
        assert (await operator.http.post("/v1/keys", json=wanted)).status_code == 201
        refused = await acme.http.post("/v1/keys", json=wanted)
        assert (refused.status_code, refused.json()["field"]) == (422, "rates.calls_per_s")


async def test_stored_bytes_of_a_tenant(make_app, tmp_path):
    async with guarded(make_app, tmp_path, quota_stored_mb=1) as callers:
        acme, other = await callers.client("acme"), await callers.client("other")
        full = await acme.ready_session()
        padded = image() + bytes(1 << 20)  # PNG ends before
        assert (await acme.http.post(f"/v1/sessions/{full}/frames", content=padded, headers=PNG)).status_code == 200
        limit_named(await acme.post(full, 2), "SKYPOSE_QUOTA_STORED_MB")
        limit_named(await acme.model(CUBE + b"2"), "SKYPOSE_QUOTA_STORED_MB")
        callers.app.state.services.stored.forget("acme")  # what is measured agrees with what was counted
        limit_named(await acme.post(full, 2), "SKYPOSE_QUOTA_STORED_MB")
        assert (await acme.http.get(f"/v1/sessions/{full}/estimates")).status_code == 200
        assert (await other.post(await other.ready_session(), 1)).status_code == 200
        assert (await acme.http.delete(f"/v1/sessions/{full}")).status_code == 204
        assert (await acme.post(await acme.ready_session(), 1)).status_code == 200


async def test_calls_under_way_are_bounded(make_app):
    """Past the limit a call is answered 503 at once; the ones under way end as if nothing had been."""
    async with running(make_app(SlowWorker, max_calls=4)) as api:
        session_id = await api.ready_session()
        answers = await asyncio.gather(*(api.post(session_id, n) for n in range(12)))
        statuses = [answer.status_code for answer in answers]
        assert statuses.count(200) >= 4
        refused = [answer for answer in answers if answer.status_code != 200]
        assert refused
        for answer in refused:
            limit_named(answer, "SKYPOSE_MAX_CALLS", "busy", 503)
        assert (await Api(api.http).post(session_id, 99)).status_code == 200


async def test_slow_sender_and_slow_reader_are_let_go(make_app):
    """Neither holds a place for good: the first is answered 408, the second cut off in the middle of a large answer."""
    app = make_app(body_timeout_s=1.0, stream_send_timeout_s=1.0, max_heavy_reads=1)
    async with served(app) as address, httpx.AsyncClient(base_url=f"http://{address}") as http:
        api = Api(http, app)
        session_id = await api.ready_session()
        await api.post(session_id, 1)
        head = f"POST /v1/sessions/{session_id}/frames HTTP/1.1\r\nHost: {address}\r\nContent-Type: image/png\r\n"
        reader, writer = await asyncio.open_connection(*address.split(":"))
        writer.write(f"{head}Content-Length: 1000\r\n\r\nabc".encode())
        assert b"408" in await reader.readline()
        await reader.readuntil(b"urn:skypose:problem:slow-body")
        writer.close()
        app.state.services.archive.pictures = large_pictures
        picture = f"/v1/sessions/{session_id}/estimates/0/frame.png"
        reader, writer = await asyncio.open_connection(*address.split(":"), limit=1024)
        writer.write(f"GET {picture} HTTP/1.1\r\nHost: {address}\r\n\r\n".encode())
        await reader.readline()
        limit_named(await http.get(picture), "SKYPOSE_MAX_HEAVY_READS", "busy", 503)
        while (await http.get(picture)).status_code == 503:
            pass
        assert len(await reader.read()) < LARGE
        writer.close()


LARGE = 1 << 26


async def large_pictures(*_, **__) -> tuple[bytes, ...]:
    return (bytes(LARGE),)


async def test_files_of_several_frames_take_turns(make_app):
    """They are large in memory: past the limit 503, and the place is free again when the last frame is tracked."""
    async with running(make_app(SlowWorker, max_batches=1)) as api:
        file = io.BytesIO()
        np.save(file, np.zeros((3, 16, 16), np.uint8))
        sessions = [await api.ready_session() for _ in range(2)]
        answers = await asyncio.gather(*(post_file(api, session_id, file.getvalue()) for session_id in sessions))
        by_status = sorted(answers, key=lambda answer: answer.status_code)
        assert by_status[0].text.count("\n") == 3
        limit_named(by_status[1], "SKYPOSE_MAX_BATCHES", "busy", 503)
        assert (await post_file(api, sessions[0], file.getvalue())).status_code == 200


async def post_file(api: Api, session_id: str, body: bytes) -> httpx.Response:
    headers = {"Content-Type": "application/x-npy"}
    return await api.http.post(f"/v1/sessions/{session_id}/frames", content=body, headers=headers)

"""Who may watch: WebSocket and SSE, through a real server."""

import json

import httpx
import pytest
import websockets
from api_client import Api
from callers import BOOTSTRAP, guarded_server

pytestmark = pytest.mark.anyio


async def test_refused_before_anything_is_accepted(make_app, tmp_path):
    async with guarded_server(make_app, tmp_path) as callers:
        acme, other = await callers.client("acme"), await callers.key("other")
        session_id = await acme.session()
        key = await callers.key("acme", "read")
        for name, headers, query, status in (
            ("none", {}, "", 401),
            ("wrong", {"Authorization": "Bearer x"}, "", 401),
            ("foreign tenant", {"Authorization": f"Bearer {other}"}, "", 404),
            ("foreign page", {"Authorization": f"Bearer {key}", "Origin": "https://attacker.example"}, "", 403),
            ("made-up ticket", {}, "?ticket=x", 401),
            ("misspelt", {"Authorization": f"Bearer {key}"}, "?aftr=3", 422),
        ):
            url = f"//{callers.address}/v1/sessions/{session_id}"
            with pytest.raises(websockets.InvalidStatus) as refusal:
                await websockets.connect(f"ws:{url}/stream{query}", additional_headers=headers)
            assert refusal.value.response.status_code == status, name
            async with httpx.AsyncClient() as http:
                answer = await http.get(f"http:{url}/events{query}", headers=headers)
            assert (answer.status_code, answer.headers["content-type"]) == (status, "application/problem+json")
        await callers.app.state.services.audit.store(final=True)
        root = await callers.with_token(BOOTSTRAP)
        actions = [entry["action"] for entry in (await root.http.get("/v1/audit")).json()["entries"]]
        stream = "/v1/sessions/{session_id}/"
        assert sorted(set(actions)) == [f"GET {stream}events", f"WS {stream}stream"]


async def test_ticket_opens_one_stream(make_app, tmp_path):
    async with guarded_server(make_app, tmp_path) as callers:
        acme = await callers.client("acme")
        session_id = await acme.ready_session()
        ticket = (await acme.http.post("/v1/tickets")).json()["ticket"]
        url = f"ws://{callers.address}/v1/sessions/{session_id}/stream?ticket={ticket}"
        own_page = {"Origin": f"http://{callers.address}"}
        async with websockets.connect(url, additional_headers=own_page) as socket:
            await acme.post(session_id, 1)
            assert json.loads(await socket.recv())["type"] == "estimate"
            with pytest.raises(websockets.InvalidStatus) as refusal:
                await websockets.connect(url)
            assert refusal.value.response.status_code == 401
        ticket = (await acme.http.post("/v1/tickets")).json()["ticket"]
        assert (await acme.http.get(f"/v1/me?ticket={ticket}", headers={"Authorization": ""})).status_code == 401


async def test_stream_ends_with_its_key(make_app, tmp_path):
    async with guarded_server(make_app, tmp_path, credential_cache_s=0) as callers:
        acme, reader = await callers.client("acme"), await callers.key("acme", "read")
        session_id = await acme.session()
        url = f"ws://{callers.address}/v1/sessions/{session_id}/stream"
        async with websockets.connect(url, additional_headers={"Authorization": f"Bearer {reader}"}) as socket:
            await acme.http.delete(f"/v1/keys/{reader.split('_')[1]}")
            with pytest.raises(websockets.ConnectionClosed) as closed:
                await socket.recv()
            assert closed.value.rcvd.code == 1008


async def test_event_stream_ends_with_its_key(make_app, tmp_path):
    async with guarded_server(make_app, tmp_path, credential_cache_s=0) as callers:
        acme, reader = await callers.client("acme"), await callers.client("acme", "read")
        session_id = await acme.session()
        ticket = (await reader.http.post("/v1/tickets")).json()["ticket"]
        url = f"http://{callers.address}/v1/sessions/{session_id}/events?ticket={ticket}"
        async with httpx.AsyncClient(timeout=30) as http, http.stream("GET", url) as answer:
            assert answer.status_code == 200
            key_id = (await reader.http.get("/v1/me")).json()["key_id"]
            await acme.http.delete(f"/v1/keys/{key_id}")
            assert await answer.aread() == b""  # complete, not cut off


async def test_streams_of_one_tenant_leave_room_for_others(make_app, tmp_path):
    async with guarded_server(make_app, tmp_path, quota_streams=1) as callers:
        sessions = {}
        for tenant in ("acme", "other"):
            api = await callers.client(tenant)
            sessions[tenant] = (await Api(api.http).session(), await callers.key(tenant))
        for tenant, (session_id, key) in sessions.items():
            url, headers = f"//{callers.address}/v1/sessions/{session_id}", {"Authorization": f"Bearer {key}"}
            async with websockets.connect(f"ws:{url}/stream", additional_headers=headers):
                async with httpx.AsyncClient(headers=headers) as http:
                    answer = await http.get(f"http:{url}/events")
                assert (answer.status_code, answer.json()["setting"]) == (429, "SKYPOSE_QUOTA_STREAMS"), tenant

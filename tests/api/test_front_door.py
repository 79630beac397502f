"""Clients that only keep others waiting: answered on the head, cut, or refused, and a good client notices nothing."""

import asyncio
import re
import resource
import socket
import struct
import sys
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager

import httpx
import pytest
import websockets
from api_client import PNG, Api, image, served
from callers import guarded_server, with_keys

from service.api import door
from service.settings import Settings

pytestmark = pytest.mark.anyio
MANY = 20
ENOUGH_S = 60  # to give up a test: none of these waits for it
CHECKPOINT = "PUT /v1/sessions/new/checkpoint"
Stream = tuple[asyncio.StreamReader, asyncio.StreamWriter]


@asynccontextmanager
async def connections(address: str, count: int, first: bytes = b"", source: str | None = None) -> AsyncIterator[list]:
    """So many, each with its first bytes sent; in their order."""
    host, port = address.split(":")
    local = None if source is None else (source, 0)
    opened: list[Stream] = [await asyncio.open_connection(host, int(port), local_addr=local) for _ in range(count)]
    try:
        for _, writer in opened:
            writer.write(first)
            await writer.drain()
        async with asyncio.timeout(ENOUGH_S):
            yield opened
    finally:
        for _, writer in opened:
            writer.close()


def head(address: str, length: int, *lines: str, call: str = "POST /v1/sessions/any/frames") -> bytes:
    """A call's, and the first byte of its body."""
    given = (f"{call} HTTP/1.1", f"Host: {address}", f"Content-Length: {length}", *lines)
    return "\r\n".join([*given, "", "x"]).encode()


async def answer(reader: asyncio.StreamReader) -> bytes:
    """All of it, when the connection has ended."""
    return await reader.read()


async def test_a_body_declared_too_large_is_answered_on_its_head(make_app):
    """At once and for good: nothing is read first, no place is held."""
    async with (
        served(make_app(max_calls=4)) as address,
        httpx.AsyncClient(base_url=f"http://{address}") as http,
        connections(address, MANY, head(address, 99_999_999_999)) as hostile,
    ):
        assert (await http.get("/v1/me")).status_code == 200
        for reader, _ in hostile:
            said = await answer(reader)
            assert said.startswith(b"HTTP/1.1 413 ")
            assert b"\r\nconnection: close\r\n" in said
            assert b"SKYPOSE_MAX_FRAME_MB" in said


async def test_a_client_in_the_middle_of_a_refused_body_reads_its_answer(make_app):
    async with served(make_app(max_frame_mb=1)) as address, httpx.AsyncClient(base_url=f"http://{address}") as http:
        for _ in range(3):
            refused = await http.post("/v1/sessions/any/frames", content=bytes(8 << 20), headers=PNG)
            assert (refused.status_code, refused.json()["setting"]) == (413, "SKYPOSE_MAX_FRAME_MB")


@pytest.mark.parametrize("credential", [(), ("Authorization: Bearer skypose_12345678_" + "a" * 43,)])
async def test_a_body_without_a_good_key_is_not_waited_for(make_app, tmp_path, credential):
    async with (
        served(with_keys(make_app, tmp_path, max_calls=4)) as address,
        connections(address, MANY, head(address, 1000, *credential)) as hostile,
    ):
        for reader, _ in hostile:
            said = await answer(reader)
            assert said.startswith(b"HTTP/1.1 401 ")
            assert b"\r\nconnection: close\r\n" in said


async def test_an_answer_in_time_for_its_body_leaves_the_connection_open(make_app):
    async with served(make_app()) as address:
        whole = head(address, 1, "Content-Type: image/png")
        async with connections(address, 1, whole) as [(reader, writer)]:
            for _ in range(2):
                said = await reader.readuntil(b"urn:skypose:problem:not-found")
                assert b"connection: close" not in said
                writer.write(whole)
            assert not reader.at_eof()


async def test_half_a_head_gives_way_to_new_connections(make_app, monkeypatch):
    """However many there are, a new connection is answered; who waits longest goes first."""
    monkeypatch.setattr(door, "PROBE_CONNECTIONS", 4)
    async with (
        served(make_app(max_connections=MANY, head_timeout_s=ENOUGH_S)) as address,
        connections(address, 2 * MANY, b"GET /v1/me HTTP/1.1\r\nHost:") as hostile,
        httpx.AsyncClient(base_url=f"http://{address}") as http,
    ):
        assert (await http.get("/healthz")).status_code == 200
        assert (await http.get("/v1/me")).status_code == 200
        for reader, _ in hostile[: MANY - 4]:
            assert await answer(reader) == b""
        assert not any(reader.at_eof() for reader, _ in hostile[-MANY // 2 :])


async def test_a_head_has_a_deadline_and_a_call_has_none(make_app):
    half = b"GET /v1/me HTTP/1.1\r\n"
    async with served(make_app(head_timeout_s=0.1)) as address, httpx.AsyncClient(base_url=f"http://{address}") as http:
        session_id = await Api(http).ready_session()
        async with websockets.connect(f"ws://{address}/v1/sessions/{session_id}/stream") as watcher:
            async with connections(address, 1, b"GET /healthz HTTP/1.1\r\nHost: a\r\n\r\n") as [(kept, writer)]:
                head = await kept.readuntil(b"\r\n\r\n")
                await kept.readexactly(int(re.search(rb"content-length: (\d+)", head)[1]))
                writer.write(half)
                assert await answer(kept) == b""  # the second head of a connection too
            for first in (b"", half):
                async with connections(address, 1, first) as [(reader, _)]:
                    assert await answer(reader) == b""
            sent = (await Api(http).post(session_id, 1)).json()
            assert sent["session_id"] in await watcher.recv()


async def test_connections_of_one_address(make_app):
    """It does not take those of others, and its own newest one is served. A proxy stands for many clients."""
    settings = {"max_connections_per_address": 4, "head_timeout_s": ENOUGH_S}
    async with (
        served(make_app(**settings)) as address,
        connections(address, MANY) as proxy,
        connections(address, MANY, source="127.0.0.2") as hostile,
    ):
        for reader, _ in hostile[:-4]:
            assert await answer(reader) == b""
        transport = httpx.AsyncHTTPTransport(local_address="127.0.0.2")
        async with httpx.AsyncClient(base_url=f"http://{address}", transport=transport) as http:
            assert (await http.get("/v1/me")).status_code == 200
        assert not any(reader.at_eof() for reader, _ in proxy)


async def test_where_all_connections_are_busy_only_probes_are_answered(make_app):
    """A WebSocket is one of them as long as it is open."""
    app = make_app(max_connections=1)
    async with served(app) as address, httpx.AsyncClient(base_url=f"http://{address}") as http:
        session_id = await Api(http).session()
        url = f"ws://{address}/v1/sessions/{session_id}/stream"
        async with websockets.connect(url):
            refused = await http.get("/v1/me")
            assert (refused.status_code, refused.json()["setting"]) == (503, "SKYPOSE_MAX_CONNECTIONS")
            assert [(await http.get(path)).status_code for path in ("/healthz", "/readyz")] == [200, 200]
            with pytest.raises(websockets.InvalidStatus) as denied:
                await websockets.connect(url)
            assert denied.value.response.status_code == 503
        open_now = app.state.services.metrics.registry.get_sample_value
        while open_now("skypose_connections") > 1:
            await asyncio.sleep(0)
        assert (await http.get("/v1/me")).status_code == 200


@pytest.mark.parametrize("setting", ["max_key_calls", "quota_calls"])
async def test_slow_bodies_of_one_key_are_its_own_loss(make_app, tmp_path, setting):
    """Past its share that key is told to wait; there are places for another tenant's calls."""
    async with guarded_server(make_app, tmp_path, max_calls=8, **{setting: 2}) as callers:
        key, other = await callers.key("acme"), await callers.key("other")
        slow = head(callers.address, 1000, f"Authorization: Bearer {key}", call="POST /v1/sessions")
        async with connections(callers.address, MANY, slow) as hostile:
            waiting = {asyncio.create_task(answer(reader)) for reader, _ in hostile}
            answered: set[asyncio.Task[bytes]] = set()
            while len(waiting) > 2:
                done, waiting = await asyncio.wait(waiting, return_when=asyncio.FIRST_COMPLETED)
                answered |= done
            for said in (task.result() for task in answered):
                assert said.startswith(b"HTTP/1.1 429 ")
                assert b"\r\nretry-after: 1\r\n" in said
                assert f"SKYPOSE_{setting.upper()}".encode() in said
            good = {"Authorization": f"Bearer {other}"}
            async with httpx.AsyncClient(base_url=f"http://{callers.address}", headers=good) as http:
                session_id = await Api(http).ready_session()
                assert (await Api(http).post(session_id, 1)).status_code == 200
            assert not any(task.done() for task in waiting)
            for task in waiting:
                task.cancel()


async def test_bytes_of_one_tenant_leave_room_for_others(make_app, tmp_path):
    async with guarded_server(make_app, tmp_path, max_pending_mb=2, quota_pending_mb=1) as callers:
        key, other = await callers.key("acme"), await callers.key("other")
        given = (f"Authorization: Bearer {key}",)
        large = head(callers.address, 1 << 21, *given, call=CHECKPOINT) + bytes(1 << 20)
        async with connections(callers.address, 1, large) as [(reader, _)]:
            said = await answer(reader)
            assert said.startswith(b"HTTP/1.1 429 ")
            assert b"SKYPOSE_QUOTA_PENDING_MB" in said
        held = head(callers.address, 1 << 20, *given, call=CHECKPOINT) + bytes((1 << 20) - 2)
        async with connections(callers.address, 1, held):
            good = {"Authorization": f"Bearer {other}"}
            async with httpx.AsyncClient(base_url=f"http://{callers.address}", headers=good) as http:
                session_id = await Api(http).ready_session()
                padded = image() + bytes(900_000)
                sent = await http.post(f"/v1/sessions/{session_id}/frames", content=padded, headers=PNG)
                assert sent.status_code == 200, sent.text


async def test_who_takes_nothing_is_cut(make_app, monkeypatch):
    """Also where the answer stays in the connection's own buffer, which closing would wait for."""
    monkeypatch.setattr(door, "LINGER_S", 0.0)
    app = make_app(stream_send_timeout_s=0.1)
    app.state.services.archive.pictures = large_pictures
    async with served(app) as address, httpx.AsyncClient(base_url=f"http://{address}") as http:
        session_id = await Api(http).ready_session()
        await Api(http).post(session_id, 1)
        ask = f"GET /v1/sessions/{session_id}/estimates/0/frame.png HTTP/1.1\r\nHost: {address}\r\n\r\n".encode()
        async with connections(address, MANY, ask):
            open_now = app.state.services.metrics.registry.get_sample_value
            while open_now("skypose_connections") > 1:
                await asyncio.sleep(0)


async def large_pictures(*_, **__) -> tuple[bytes, ...]:
    return (bytes(1 << 26),)


@pytest.mark.skipif(sys.platform != "linux", reason="the kernel's queue is told by Linux only")
async def test_the_kernel_keeps_more_connections_than_one_turn_accepts():
    async with await asyncio.start_server(lambda *_: None, "127.0.0.1", 0, backlog=1) as listener:
        door.deepen([listener])
        told = listener.sockets[0].getsockopt(socket.IPPROTO_TCP, socket.TCP_INFO, 104)
    (queue,) = struct.unpack_from("I", told, 28)  # tcpi_sacked, of a socket that listens
    assert queue > 16  # of 2048 what the machine allows


def test_connections_leave_handles_for_the_rest(monkeypatch):
    monkeypatch.setattr(resource, "getrlimit", lambda _: (1024, 4096))
    assert door.connection_limit(Settings()) == 848
    assert door.connection_limit(Settings(max_connections=100)) == 100
    assert door.connection_limit(Settings(database_url="postgresql+psycopg://there/it")) == 424
    monkeypatch.setattr(resource, "getrlimit", lambda _: (resource.RLIM_INFINITY, 4096))
    assert door.connection_limit(Settings()) == Settings().max_connections


async def test_a_connection_waits_longer_for_its_next_call_than_clients_keep_theirs(make_app):
    """Else a call is now and then sent into one that is just ending, and is lost."""
    clients = httpx.AsyncHTTPTransport()._pool._keepalive_expiry
    assert clients is not None
    assert door.server_config(make_app()).timeout_keep_alive > 2 * clients

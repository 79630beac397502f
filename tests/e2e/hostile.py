"""A good client beside many connections of one hostile kind after the other: what its frames and the probes take.

The hostile connections are a program of their own (this file, run): their own work is not to be measured.
"""

import asyncio
import base64
import contextlib
import json
import os
import random
import resource
import sys
import time
from collections import Counter
from collections.abc import AsyncIterator, Awaitable, Callable
from pathlib import Path
from typing import Any

import httpx
import numpy as np
from passes import PNG, fake_pass
from server_process import Server

KINDS = {
    "oversized body": "declares 100 GB, sends a byte; no key",
    "half head": "a byte of a head in five seconds",
    "slow body, good key": "a byte of a body in five seconds",
    "slow body, no key": "the same",
    "slow body, false key": "the same",
    "silent socket": "connects",
    "silent WebSocket": "watches a session with a good key, answers nothing",
}
AGAIN_S = 10.0  # a hostile connection is opened at any time within so long, and again when it has ended
TRICKLE_S = 5.0
PROBE_EVERY_S = 0.05
SLOWER_BY = 3.0
PROBED_WITHIN_S = 0.1
HOSTILE_NICE = 5  # it is to wait, not to compute


def bearer(key: str) -> dict[str, str]:
    """The header that shows a key."""
    return {"Authorization": f"Bearer {key}"}


def first_bytes(kind: str, key: str, session: str) -> tuple[bytes, bool]:
    """What a hostile connection begins with, and whether it goes on, a byte at a time."""
    shown = {"slow body, good key": key, "slow body, false key": "skypose_12345678_" + "a" * 43}.get(kind)
    credential = f"Authorization: Bearer {shown}\r\n" if shown else ""
    if kind == "silent socket":
        return b"", False
    if kind == "half head":
        return b"POST /v1/sessions HTTP/1.1\r\nHost: 127.0.0.1\r\nX-Slow: ", True
    if kind == "silent WebSocket":
        nonce = base64.b64encode(os.urandom(16)).decode()
        upgrade = (
            f"Upgrade: websocket\r\nConnection: Upgrade\r\nSec-WebSocket-Version: 13\r\nSec-WebSocket-Key: {nonce}"
        )
        call = f"GET /v1/sessions/{session}/stream HTTP/1.1\r\nHost: 127.0.0.1\r\nAuthorization: Bearer {key}\r\n"
        return f"{call}{upgrade}\r\n\r\n".encode(), False
    length = 99_999_999_999 if kind == "oversized body" else 200_000
    head = f"POST /v1/sessions HTTP/1.1\r\nHost: 127.0.0.1\r\nContent-Length: {length}\r\n{credential}\r\nx"
    return head.encode(), kind != "oversized body"


async def hold(port: int, begin: bytes, trickles: bool, seen: Counter[str]) -> None:
    """One hostile connection, opened again when it has ended."""
    while True:
        await asyncio.sleep(random.uniform(0, AGAIN_S))
        with contextlib.suppress(OSError):
            reader, writer = await asyncio.open_connection("127.0.0.1", port)
            seen["opened"] += 1
            try:
                writer.write(begin)
                seen[await _end(reader, writer, trickles)] += 1
            finally:
                writer.close()


async def _end(reader: asyncio.StreamReader, writer: asyncio.StreamWriter, trickles: bool) -> str:
    """Wait for the end of a connection. Returns the status it was answered with, or that it was cut."""
    said = b""
    while True:
        try:
            async with asyncio.timeout(TRICKLE_S if trickles else None):
                piece = await reader.read(4096)
        except TimeoutError:
            writer.write(b"x")
            continue
        if not piece:
            return said[9:12].decode() or "cut"
        said = (said + piece)[:12]


async def attack(kind: str, connections: int, port: int, key: str, session: str) -> None:
    """All of them, until nobody listens; then say what they met."""
    os.nice(HOSTILE_NICE)
    seen: Counter[str] = Counter()
    begin, trickles = first_bytes(kind, key, session)
    tasks = [asyncio.create_task(hold(port, begin, trickles, seen)) for _ in range(connections)]
    await asyncio.sleep(AGAIN_S)
    print("open", flush=True)
    await asyncio.to_thread(sys.stdin.read)
    for task in tasks:
        task.cancel()
    print(json.dumps(seen), flush=True)


@contextlib.contextmanager
def handles(most: int) -> Any:
    """The limit of open files of what is started within."""
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (most, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard))


class Hostile:
    """A good client alone, then beside each kind. ``keys``: of a good and of a hostile tenant."""

    def __init__(self, server: Server, keys: tuple[str, str], seconds: float, connections: int) -> None:
        self._server = server
        self._good, self._hostile = keys
        self._seconds = seconds
        self._connections = connections
        self._given = fake_pass(32)

    async def run(self, begin: Callable[..., Awaitable[str]]) -> dict[str, Any]:
        """The figures."""
        async with (
            httpx.AsyncClient(base_url=self._server.url, timeout=60, headers=bearer(self._good)) as good,
            httpx.AsyncClient(base_url=self._server.url, timeout=60, headers=bearer(self._hostile)) as theirs,
        ):
            watched = await begin(theirs, self._given)
            alone = await self._measure(good, await self._started(good, begin))
            kinds = {}
            for kind in KINDS:
                session = await self._started(good, begin)
                async with self._attacked(kind, watched) as met:
                    kinds[kind] = await self._measure(good, session)
                kinds[kind]["hostile"] = met
        held = all(
            found["frame_p99_ms"] < SLOWER_BY * alone["frame_p99_ms"]
            and found["healthz_p99_ms"] < PROBED_WITHIN_S * 1e3
            and found["healthz_max_ms"] != float("inf")  # each was answered
            and not found["refused"]
            for found in kinds.values()
        )
        return {"connections": self._connections, "alone": alone, "kinds": kinds, "met": held}

    async def _started(self, http: httpx.AsyncClient, begin: Callable[..., Awaitable[str]]) -> str:
        """A session after its first frame, which takes longer than others."""
        session = await begin(http, self._given)
        url = f"/v1/sessions/{session}/frames/0"
        (await http.put(url, content=self._given.frames[0], headers=PNG)).raise_for_status()
        return session

    @contextlib.asynccontextmanager
    async def _attacked(self, kind: str, session: str) -> AsyncIterator[dict[str, int]]:
        port, count = str(self._server.port), str(self._connections)
        command = [sys.executable, str(Path(__file__)), kind, count, port, self._hostile, session]
        pipe = asyncio.subprocess.PIPE
        process = await asyncio.create_subprocess_exec(*command, stdin=pipe, stdout=pipe)
        assert process.stdout is not None
        assert (await process.stdout.readline()).strip() == b"open"
        met: dict[str, int] = {}
        yield met
        said, _ = await process.communicate(b"")  # the end of its input ends it
        met.update(json.loads(said))

    async def _measure(self, http: httpx.AsyncClient, session: str) -> dict[str, Any]:
        """Frames one after the other, and a probe on a new connection every 50 ms."""
        until = time.monotonic() + self._seconds
        probes = asyncio.create_task(self._probe(until))
        times: list[float] = []
        refused: Counter[str] = Counter()
        while time.monotonic() < until:
            began = time.monotonic()
            index = len(times) + 1
            image = self._given.frames[index % len(self._given.frames)]
            try:
                answer = await http.put(f"/v1/sessions/{session}/frames/{index}", content=image, headers=PNG)
            except httpx.TransportError as error:
                refused[type(error).__name__] += 1
                continue
            if answer.status_code == 200:
                times.append(time.monotonic() - began)
            else:
                refused[str(answer.status_code)] += 1
        probed = np.array(await probes) * 1e3
        frames = np.array(times) * 1e3
        return {
            "frames": len(times),
            "refused": refused,
            "frame_p50_ms": round(float(np.percentile(frames, 50)), 1),
            "frame_p99_ms": round(float(np.percentile(frames, 99)), 1),
            "healthz_p50_ms": round(float(np.percentile(probed, 50)), 1),
            "healthz_p99_ms": round(float(np.percentile(probed, 99)), 1),
            "healthz_max_ms": round(float(probed.max()), 1),
        }

    async def _probe(self, until: float) -> list[float]:
        times = []
        while time.monotonic() < until:
            began = time.monotonic()
            try:
                said = await self._asked(b"GET /healthz HTTP/1.1\r\nHost: 127.0.0.1\r\nConnection: close\r\n\r\n")
            except OSError:
                said = b""
            times.append(time.monotonic() - began if said.startswith(b"HTTP/1.1 200 ") else float("inf"))
            await asyncio.sleep(PROBE_EVERY_S)
        return times

    async def _asked(self, call: bytes) -> bytes:
        reader, writer = await asyncio.open_connection("127.0.0.1", self._server.port)
        try:
            writer.write(call)
            return await reader.read()
        finally:
            writer.close()


def table(figures: dict[str, Any]) -> str:
    """The figures for people."""
    alone = figures["alone"]
    lines = [
        f"{figures['connections']} connections of each kind, load {figures['load']}",
        "",
        "| beside | frames | p50, p99 ms | of p99 alone | /healthz p50, p99, max ms | what the hostile met |",
        "|---|---|---|---|---|---|",
    ]
    for kind, found in {"nobody": alone, **figures["kinds"]}.items():
        met = ", ".join(f"{count} × {what}" for what, count in found.get("hostile", {}).items())
        probed = f"{found['healthz_p50_ms']}, {found['healthz_p99_ms']}, {found['healthz_max_ms']}"
        times = f"{found['frame_p99_ms'] / alone['frame_p99_ms']:.2f}"
        frames = f"{found['frames']} | {found['frame_p50_ms']}, {found['frame_p99_ms']} | {times}"
        lines.append(f"| {kind} | {frames} | {probed} | {met} |")
    return "\n".join([*lines, "", "held" if figures["met"] else "NOT held"])


if __name__ == "__main__":
    asyncio.run(attack(sys.argv[1], int(sys.argv[2]), int(sys.argv[3]), sys.argv[4], sys.argv[5]))

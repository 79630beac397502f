"""Clients that come, track, watch, go, and now and then crash; and whether the service grows beyond its data."""

import asyncio
import random
import sqlite3
import time
from collections import Counter
from collections.abc import Awaitable, Callable
from pathlib import Path
from typing import Any

import httpx
import numpy as np
from memory import descendants, over_bound, peaks_mb, status
from passes import PNG, Pass, box_pass
from server_process import Server

CLIENTS = 6
CRASHING = 0.01  # of frames: the connection is cut in the middle of the call
AUDIT_ROW_BYTES = 250  # with its indexes
WARM_SHARE = 0.25  # of the time, not looked at: caches fill
GROWTH = {"rss_mb": 0.05, "handles": 0.05, "threads": 0.05, "database_mb_beyond_data": 0.10}  # of the level


class Soak:
    """A few clients for so long. Sessions are deleted at their end, so that what stays is growth."""

    def __init__(self, server: Server, seconds: float, begin: Callable[..., Awaitable[str]]) -> None:
        self._server = server
        self._seconds = seconds
        self._begin = begin
        self._given: Pass = box_pass(32)
        self._counts: Counter[str] = Counter()
        self._samples: list[dict[str, float]] = []
        self._peaks: dict[str, int] = {}

    async def run(self) -> dict[str, Any]:
        """The figures."""
        until = time.monotonic() + self._seconds
        limits = httpx.Limits(max_connections=64)
        async with httpx.AsyncClient(base_url=self._server.url, timeout=120, limits=limits) as http:
            watcher = asyncio.create_task(self._sample(until))
            await asyncio.gather(*(self._client(http, n, until) for n in range(CLIENTS)))
            await watcher
        return self._figures()

    async def _client(self, http: httpx.AsyncClient, number: int, until: float) -> None:
        dice = random.Random(number)
        while time.monotonic() < until:
            session = await self._begin(http, self._given)
            self._counts["sessions"] += 1
            index = 0
            for _ in range(dice.randint(3, 40)):
                if time.monotonic() >= until:
                    break
                if dice.random() < CRASHING:
                    await self._crash(session, index)
                index = await self._frame(http, session, index)
            if dice.random() < 0.3:
                await self._watch(http, session)
            (await http.delete(f"/v1/sessions/{session}")).raise_for_status()

    async def _frame(self, http: httpx.AsyncClient, session: str, index: int) -> int:
        url = f"/v1/sessions/{session}/frames/{index}"
        answer = await http.put(url, content=self._given.frames[index % 32], headers=PNG)
        self._counts[f"status {answer.status_code}"] += 1
        return index + (answer.status_code == 200)

    async def _crash(self, session: str, index: int) -> None:
        """Half a request, or a whole one whose answer nobody waits for."""
        _, writer = await asyncio.open_connection("127.0.0.1", self._server.port)
        body = self._given.frames[index % 32]
        head = f"PUT /v1/sessions/{session}/frames/{index} HTTP/1.1\r\nHost: x\r\nContent-Type: image/png\r\n"
        whole = f"{head}Content-Length: {len(body)}\r\n\r\n".encode() + body
        writer.write(whole if index % 2 else whole[: len(whole) // 2])
        await writer.drain()
        writer.transport.abort()
        self._counts["crashed clients"] += 1

    async def _watch(self, http: httpx.AsyncClient, session: str) -> None:
        async with http.stream("GET", f"/v1/sessions/{session}/events?after=0") as stream:
            async for _ in stream.aiter_lines():
                self._counts["watchers"] += 1
                return  # it goes away without a word

    async def _sample(self, until: float) -> None:
        while time.monotonic() < until:
            await asyncio.sleep(min(5.0, self._seconds / 40))
            self._samples.append({"at": time.monotonic(), **await asyncio.to_thread(self._look)})

    def _look(self) -> dict[str, float]:
        for name, peak in peaks_mb(self._server.pid).items():
            self._peaks[name] = max(self._peaks.get(name, 0), peak)
        pids = [self._server.pid, *descendants(self._server.pid)]
        return {
            "rss_mb": sum(status(pid, "VmRSS") for pid in pids) / 1024,
            "threads": sum(status(pid, "Threads") for pid in pids),
            "handles": sum(_handles(pid) for pid in pids),
            "database_mb_beyond_data": _beyond_data_mb(self._server.data / "skypose.sqlite3"),
        }

    def _figures(self) -> dict[str, Any]:
        warm = self._samples[int(WARM_SHARE * len(self._samples)) :]
        at = np.array([sample["at"] for sample in warm])
        growth = {name: _growth(at, np.array([sample[name] for sample in warm])) for name in GROWTH}
        met = all(growth[name]["share_of_level"] <= most for name, most in GROWTH.items())
        bad = [name for name in self._counts if name.startswith("status ") and name[7:] not in ("200", "429", "503")]
        minutes = round(self._seconds / 60, 1)
        over = over_bound(self._peaks)
        told = {"growth": growth, "peak_mb": self._peaks, "over_bound": over}
        return {"minutes": minutes, **dict(self._counts), **told, "met": bool(met and not bad and not over)}


def _growth(at: np.ndarray, values: np.ndarray) -> dict[str, float]:
    """Theil and Sen's slope, the median over all pairs of samples: a single peak does not tilt it."""
    i, j = np.triu_indices(len(at), 1)
    slope = float(np.median((values[j] - values[i]) / (at[j] - at[i])))
    level = float(np.median(values))
    over_all = slope * float(at[-1] - at[0])
    return {
        "level": round(level, 1),
        "per_hour": round(slope * 3600, 2),
        "share_of_level": round(over_all / max(level, 1.0), 4),
    }


def _handles(pid: int) -> int:
    try:
        return sum(1 for _ in Path(f"/proc/{pid}/fd").iterdir())  # root's alone, unless the sandbox is off
    except (FileNotFoundError, ProcessLookupError):
        return 0


def _beyond_data_mb(file: Path) -> float:
    """Size of the database less what its rows hold: sessions that are there and the audit log are no growth."""
    columns = {
        "frame_bodies": "body",
        "particles": "state",
        "estimates": "document",
        "beliefs": "belief",
        "blobs": "data",
    }
    with sqlite3.connect(f"file:{file}?mode=ro", uri=True) as connection:
        pages, size = (connection.execute(f"PRAGMA {name}").fetchone()[0] for name in ("page_count", "page_size"))
        kept = connection.execute("SELECT count(*) FROM audit").fetchone()[0] * AUDIT_ROW_BYTES
        for table, column in columns.items():
            kept += connection.execute(f"SELECT coalesce(sum(length({column})), 0) FROM {table}").fetchone()[0]
    connection.close()
    return float(max(pages * size - kept, 0) / 1e6)

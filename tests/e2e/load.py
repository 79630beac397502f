"""Load on a real server, mostly with the real tracker: fairness, overload, hostile connections, a soak.

    python tests/e2e/load.py fair [--sessions 16] [--seconds 60]
    python tests/e2e/load.py overload [--seconds 60] [--times 4]
    python tests/e2e/load.py hostile [--connections 1000] [--seconds 15] [--handles 1024]    # of each of seven kinds
    python tests/e2e/load.py soak [--minutes 30]            # the long form: --minutes 420

Each prints its figures (as JSON, or a table) and ends with 1 where a goal is missed. Clients are coroutines in this
process, hostile ones in another.
"""

import argparse
import asyncio
import json
import os
import random
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path
from typing import Any

sys.path[:0] = [str(Path(__file__).resolve().parents[2]), str(Path(__file__).resolve().parent)]

import httpx  # noqa: E402
import numpy as np  # noqa: E402
from figures import finish  # noqa: E402
from hostile import Hostile, handles, table  # noqa: E402
from passes import PNG, Pass, box_pass  # noqa: E402
from server_process import Server  # noqa: E402
from soak import Soak  # noqa: E402
from typer.testing import CliRunner  # noqa: E402

from service.cli import app  # noqa: E402

SMALL = {"filter": {"particles": 300}}
FAIR_WITHIN = 0.20
REFUSED_WITHIN_S = 0.1
SLOWER_BY = 3.0
QUEUE = 2  # frames waiting or under way: what keeps an accepted frame's time below three of its own


async def begin(http: httpx.AsyncClient, given: Pass) -> str:
    """A session that is ready."""
    model = (await http.post("/v1/models", files={"file": ("body.stl", given.mesh)})).raise_for_status().json()
    body = {"model_id": model["model_id"], **SMALL}
    session = (await http.post("/v1/sessions", json=body)).raise_for_status().json()["session_id"]
    for image in given.background:
        (await http.post(f"/v1/sessions/{session}/background", content=image, headers=PNG)).raise_for_status()
    return str(session)


async def in_turn(http: httpx.AsyncClient, session: str, given: Pass, until: float) -> list[float]:
    """Frames one after the other. Seconds of each; raises for an answer that is not that of its frame."""
    times: list[float] = []
    while time.monotonic() < until:
        n = len(times)
        began = time.monotonic()
        url = f"/v1/sessions/{session}/frames/{n}"
        answer = await http.put(url, content=given.frames[n % len(given.frames)], headers=PNG)
        assert answer.status_code == 200, answer.text
        assert answer.json()["index"] == n, "out of order"
        times.append(time.monotonic() - began)
    return times


async def fair(server: Server, sessions: int, seconds: float) -> dict[str, Any]:
    """So many clients at once, each as fast as it is answered."""
    given = box_pass(32)
    async with httpx.AsyncClient(base_url=server.url, timeout=120, limits=httpx.Limits(max_connections=64)) as http:
        names = [await begin(http, given) for _ in range(sessions)]
        for name in names:  # the first frame is a search of the whole space: not what is compared
            (await http.put(f"/v1/sessions/{name}/frames/0", content=given.frames[0], headers=PNG)).raise_for_status()
        names = [await begin(http, given) for _ in range(sessions)]
        until = time.monotonic() + seconds
        times = await asyncio.gather(*(in_turn(http, name, given, until) for name in names))
        stored = [await _indexes(http, name) for name in names]
    counts = [len(found) for found in times]
    mean = sum(counts) / len(counts)
    worst = max(abs(count - mean) / mean for count in counts)
    in_order = all(found == list(range(len(found))) for found in stored)
    return {
        "sessions": sessions,
        "frames_per_s": round(sum(counts) / seconds, 1),
        "frames_per_session": [min(counts), max(counts)],
        "farthest_from_mean": round(worst, 3),
        "in_order": in_order,
        "met": in_order and worst <= FAIR_WITHIN,
    }


async def _indexes(http: httpx.AsyncClient, session: str) -> list[int]:
    found, url = [], f"/v1/sessions/{session}/estimates?limit=1000"
    while url:
        page = (await http.get(url)).raise_for_status().json()
        found += [estimate["index"] for estimate in page["estimates"]]
        url = page["next"]
    return found


async def overload(server: Server, seconds: float, times: float) -> dict[str, Any]:
    """First one client alone, then frames of 16 sessions at a rate of so many times what that client got through."""
    given = box_pass(32)
    dice = random.Random(1)
    async with httpx.AsyncClient(base_url=server.url, timeout=30, limits=httpx.Limits(max_connections=256)) as http:
        alone = await in_turn(http, await begin(http, given), given, time.monotonic() + min(seconds, 20.0))
        names = [await begin(http, given) for _ in range(16)]
        for name in names:
            (await http.post(f"/v1/sessions/{name}/frames", content=given.frames[0], headers=PNG)).raise_for_status()
        rate = times * len(alone) / sum(alone)
        answers: list[tuple[int, float]] = []
        tasks: set[asyncio.Task[None]] = set()
        until = time.monotonic() + seconds
        due = time.monotonic()
        while time.monotonic() < until:
            due += dice.expovariate(rate)
            await asyncio.sleep(max(due - time.monotonic(), 0))
            task = asyncio.create_task(_post(http, dice.choice(names), dice.choice(given.frames), answers))
            tasks.add(task)
            task.add_done_callback(tasks.discard)
        await asyncio.gather(*tasks)
    return _overload_figures(alone[1:], answers, rate)


async def _post(http: httpx.AsyncClient, session: str, image: bytes, answers: list[tuple[int, float]]) -> None:
    began = time.monotonic()
    try:
        status = (await http.post(f"/v1/sessions/{session}/frames", content=image, headers=PNG)).status_code
    except httpx.TimeoutException:
        status = 0
    answers.append((status, time.monotonic() - began))


def _overload_figures(alone: list[float], answers: list[tuple[int, float]], rate: float) -> dict[str, Any]:
    statuses = Counter(status for status, _ in answers)
    taken = [seconds for status, seconds in answers if status == 200]
    refused = [seconds for status, seconds in answers if status in (429, 503)]
    unloaded, loaded = np.percentile(alone, 99), np.percentile(taken, 99)
    return {
        "offered_per_s": round(rate, 1),
        "accepted_per_s_of_unloaded": round(len(taken) / max(len(answers), 1) * rate / (len(alone) / sum(alone)), 2),
        "statuses": {str(status): count for status, count in sorted(statuses.items())},
        "refused_p99_ms": round(float(np.percentile(refused, 99)) * 1e3, 1),
        "refused_max_ms": round(max(refused) * 1e3, 1),
        "unloaded_p50_p99_ms": [round(float(np.percentile(alone, p)) * 1e3, 1) for p in (50, 99)],
        "accepted_p50_p99_ms": [round(float(np.percentile(taken, p)) * 1e3, 1) for p in (50, 99)],
        "met": bool(
            set(statuses) <= {200, 429, 503}
            and np.percentile(refused, 99) <= REFUSED_WITHIN_S
            and loaded < SLOWER_BY * unloaded
        ),
    }


def key_of(data: Path, tenant: str) -> str:
    """A new key of a tenant."""
    wanted = ("--role", "operate", "--tenant", tenant, "--name", "load", "--data", str(data), "--json")
    made: dict[str, str] = json.loads(CliRunner().invoke(app, ["keys", "create", *wanted]).stdout)
    return made["key"]


def hostile(folder: Path, given: argparse.Namespace) -> dict[str, Any]:
    """Hostile connections at a service that wants keys and has few handles.

    Its worker answers at once, so a frame takes what the web process takes: no tracking hides a delay.
    """
    data = folder / "data"
    keys = key_of(data, "good"), key_of(data, "hostile")
    server = Server(data, "fake_worker:FakeWorker", log_level="error", auth="required")
    with handles(given.handles):
        server.start()
    try:
        return asyncio.run(Hostile(server, keys, given.seconds, given.connections).run(begin))
    finally:
        server.stop()


def measure(kind: str, given: argparse.Namespace) -> dict[str, Any]:
    """One of the four on a fresh server."""
    if kind == "hostile":
        with tempfile.TemporaryDirectory() as folder:
            found = hostile(Path(folder), given)
        return {"command": kind, **found, "load": [round(load, 1) for load in os.getloadavg()]}
    settings: dict[str, object] = {"log_level": "error"}
    if kind == "overload":
        settings["max_waiting_frames"] = QUEUE
    if kind == "soak":
        settings |= {"session_idle_s": 5, "max_resident_sessions": 24, "keep_frame_bodies": 20, "keep_particle_sets": 4}
    with tempfile.TemporaryDirectory() as folder:
        server = Server(Path(folder) / "data", **settings)
        server.start()
        try:
            if kind == "fair":
                found = asyncio.run(fair(server, given.sessions, given.seconds))
            elif kind == "overload":
                found = asyncio.run(overload(server, given.seconds, given.times))
            else:
                found = asyncio.run(Soak(server, given.minutes * 60, begin).run())
        finally:
            server.stop()
    return {"command": kind, **found, "load": [round(load, 1) for load in os.getloadavg()]}


def main() -> None:
    """The command."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("kind", choices=("fair", "overload", "hostile", "soak"))
    parser.add_argument("--sessions", type=int, default=16)
    parser.add_argument("--seconds", type=float, help="60; hostile: 15 of each kind")
    parser.add_argument("--connections", type=int, default=1000)
    parser.add_argument("--handles", type=int, default=1024)
    parser.add_argument("--times", type=float, default=4.0)
    parser.add_argument("--minutes", type=float, default=30.0)
    parser.add_argument("--json", type=Path)
    given = parser.parse_args()
    given.seconds = given.seconds or (15.0 if given.kind == "hostile" else 60.0)
    figures = measure(given.kind, given)
    finish(figures, figures["met"], given.json, table(figures) if given.kind == "hostile" else None)


if __name__ == "__main__":
    main()

"""How many frames a second one PostgreSQL takes from several web processes, and how soon another process hears of each.

    python tests/e2e/commits.py [--processes 2] [--sessions 16] [--seconds 8] [--kilobytes 100]

Each process stores frames of its sessions as the service does, one transaction each, and nothing else: no HTTP, no
tracking. One more process listens as a watcher's would. Tables, disk and ``fsync`` are those of a durable server.
"""

import argparse
import asyncio
import json
import multiprocessing
import sys
import time
from pathlib import Path
from typing import Any

sys.path[:0] = [str(Path(__file__).resolve().parents[n]) for n in (2, 1)]

import numpy as np  # noqa: E402
from postgres_server import Postgres  # noqa: E402

from service.sessions.hub import Hub  # noqa: E402
from service.store import frames, models, sessions  # noqa: E402
from service.store.base import FrameRecord, ModelRecord, Retention, SessionRecord  # noqa: E402
from service.store.postgres import PostgresDatabase  # noqa: E402

KEEP = Retention(1000, 64, 16)
HEAR_S = 2.0


def _database(url: str, name: str, connections: int) -> PostgresDatabase:
    return PostgresDatabase(url, sender=name, connections=connections, reader_threads=1, wait_s=10.0, idle_s=5.0)


def _frame(session: str, index: int, body: bytes, state: bytes) -> FrameRecord:
    head = {"session_id": session, "epoch": 0, "index": index, "sha256": "h", "idempotency_key": None, "query": {}}
    times = {"time": "t", "time_given": None, "time_s": float(index), "created_at": "t"}
    content = {"media_type": "image/png", "body": body, "status": "tracking", "document": b"{}" * 2000, "state": state}
    return FrameRecord(**head, **times, **content)


async def _store(url: str, name: str, mine: list[str], kilobytes: int, until: float) -> list[tuple[str, float]]:
    database = _database(url, name, 8)
    await database.open()
    database.listen(lambda _: None, lambda: None)
    hub = Hub(database, ring=1, max_lag=1, heartbeat_s=1, max_watchers=1)
    rest = np.random.default_rng(0).bytes(1024 * kilobytes)
    third = len(rest) // 3
    done = []

    async def one(session: str) -> None:
        index = 0
        while time.time() < until:
            seq = await database.write(frames.append, _frame(session, index, rest[:third], rest[third:]), KEEP)
            done.append((f"{session} {seq}", time.time()))
            hub.publish(session, seq, b"{}")
            index += 1

    await asyncio.gather(*(one(session) for session in mine))
    await database.close()
    return done


def _storing(url: str, name: str, mine: list[str], kilobytes: int, until: float, answers: Any) -> None:
    answers.put(asyncio.run(_store(url, name, mine, kilobytes, until)))


async def _begin(url: str, n_sessions: int) -> list[str]:
    database = _database(url, "first", 1)
    await database.open()
    await database.write(models.add, ModelRecord("m", "n", "glb", "blob", {}, "t"), b"mesh")
    names = [f"s{n}" for n in range(n_sessions)]
    for name in names:
        await database.write(sessions.add, SessionRecord(name, "m", None, {"filter": {"particles": 500}}, (), "t", "t"))
    await database.close()
    return names


def run(n_processes: int, n_sessions: int, seconds: float, kilobytes: int, postgres: Postgres) -> dict[str, Any]:
    """Frames a second, and milliseconds from a frame's commit until it is heard of elsewhere."""
    url = postgres.database()
    names = asyncio.run(_begin(url, n_sessions))
    context = multiprocessing.get_context("spawn")
    answers, until = context.Queue(), time.time() + HEAR_S + seconds
    children = [
        context.Process(target=_storing, args=(url, f"p{n}", names[n::n_processes], kilobytes, until, answers))
        for n in range(n_processes)
    ]
    heard: list[tuple[str, int, float]] = []

    async def watch() -> list[tuple[str, float]]:
        database = _database(url, "watcher", 1)
        await database.open()
        database.listen(lambda signal: heard.append((signal.key, signal.number, time.time())), lambda: None)
        stored = [await asyncio.to_thread(answers.get) for _ in children]
        await asyncio.sleep(HEAR_S)
        await database.close()
        return [one for some in stored for one in some]

    for child in children:
        child.start()
    stored = asyncio.run(watch())
    for child in children:
        child.join()
    return _figures(stored, heard)


def _figures(stored: list[tuple[str, float]], heard: list[tuple[str, int, float]]) -> dict[str, Any]:
    known: dict[str, float] = {}
    reached: dict[str, int] = {}
    for session, number, moment in heard:  # a signal says that everything up to its number is there
        for seq in range(reached.get(session, 0) + 1, number + 1):
            known[f"{session} {seq}"] = moment
        reached[session] = max(number, reached.get(session, 0))
    times = [moment for _, moment in stored]
    late = [1e3 * (known[name] - moment) for name, moment in stored if name in known]
    return {
        "frames": len(stored),
        "frames_per_s": round((len(times) - 1) / (max(times) - min(times)), 1),
        "signals": len(heard),
        "not_heard_of": len(stored) - len(late),
        "heard_after_ms": {f"p{p}": round(float(np.percentile(late, p)), 2) for p in (50, 99, 100)},
    }


def main() -> None:
    """The command."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--processes", type=int, default=2)
    parser.add_argument("--sessions", type=int, default=16)
    parser.add_argument("--seconds", type=float, default=8.0)
    parser.add_argument("--kilobytes", type=int, default=100, help="of each frame: its file and its particles")
    given = parser.parse_args()
    postgres = Postgres(durable=True)
    try:
        print(json.dumps(run(given.processes, given.sessions, given.seconds, given.kilobytes, postgres), indent=1))
    finally:
        postgres.close()


if __name__ == "__main__":
    main()

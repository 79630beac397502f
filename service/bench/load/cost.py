"""What a frame costs: computing time of the processes, rows and bytes of the database, bytes of the wire.

Computing time is read from /proc, so only on Linux and only of a service on this machine.
"""

from __future__ import annotations

import os
import sqlite3
from collections.abc import Iterator
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Protocol

from service.bench.load.clients import Tally
from service.bench.load.plan import Cost

_PROC = Path("/proc")
_TABLES = ("frames", "frame_bodies", "estimates", "particles", "beliefs", "events")  # what a frame adds to
_ADDED = "SELECT coalesce(sum(n), 0) FROM (SELECT max(idx) + 1 AS n FROM {} GROUP BY session_id)"


@dataclass(frozen=True)
class Usage:
    """Counters since some beginning; None where they cannot be read."""

    web_cpu_s: float | None = None
    worker_cpu_s: float | None = None
    client_cpu_s: float | None = None
    rows: float | None = None
    database_bytes: float | None = None
    log_bytes: float | None = None

    def __sub__(self, before: Usage) -> Usage:
        return Usage(*(_less(getattr(self, f.name), getattr(before, f.name)) for f in fields(self)))


def _less(after: float | None, before: float | None) -> float | None:
    return None if after is None or before is None else after - before


class Meter(Protocol):
    """Reads the counters of one service."""

    def read(self) -> Usage:
        """As they are now."""
        ...


class ClientMeter:
    """Of a service that is somewhere else: only this process can be seen."""

    def read(self) -> Usage:
        """The clients' own computing time."""
        return Usage(client_cpu_s=_own_cpu_s())


class ServerMeter:
    """Of a service that this process started. Its web process writes the database, its other processes track."""

    def __init__(self, pid: int, database: Counters) -> None:
        self._pid, self._database = pid, database

    def read(self) -> Usage:
        """All counters."""
        stored = self._database.read(self._pid)
        if not _PROC.is_dir():
            return Usage(None, None, _own_cpu_s(), stored.rows, stored.size_bytes, stored.log_bytes)
        web_s = cpu_s(self._pid)
        workers_s = sum(cpu_s(pid) for pid in descendants(self._pid))
        return Usage(web_s, workers_s, _own_cpu_s(), stored.rows, stored.size_bytes, stored.log_bytes)


@dataclass(frozen=True)
class Stored:
    """A database's counters: rows written, its size, what went to disk or log for it."""

    rows: float
    size_bytes: float
    log_bytes: float | None


class Counters(Protocol):
    """Reads a database's counters."""

    def read(self, pid: int) -> Stored:
        """As they are now; ``pid`` is the process that writes."""
        ...


class SqliteCounters:
    """Rows that frames have added, those that were dropped since for their age too, and the pages in use.

    Rows are counted by the last index of each session, for the old ones of some tables are not there any more. The
    update of the session's own row, and what is dropped, are not in it.
    """

    def __init__(self, file: Path) -> None:
        self._file = file

    def read(self, pid: int) -> Stored:
        """Counted in one read of the database."""
        connection = sqlite3.connect(f"file:{self._file}?mode=ro", uri=True, timeout=30.0)
        try:
            rows = sum(connection.execute(_ADDED.format(table)).fetchone()[0] for table in _TABLES)
            names = ("page_count", "freelist_count", "page_size")
            pages, free, size = (connection.execute(f"PRAGMA {name}").fetchone()[0] for name in names)
        finally:
            connection.close()
        return Stored(rows, (pages - free) * size, written_bytes(pid))


class PostgresCounters:
    """The server's own statistics: rows inserted, updated and deleted; the database's size; its write-ahead log.

    Rows are those of the tables, not the pieces of two kilobytes in which PostgreSQL keeps large values beside them.
    """

    _QUERY = (
        "SELECT sum(n_tup_ins + n_tup_upd + n_tup_del), pg_database_size(current_database()), "
        "pg_wal_lsn_diff(pg_current_wal_lsn(), '0/0') FROM pg_stat_user_tables"
    )

    def __init__(self, url: str) -> None:
        self._url = url

    def read(self, pid: int) -> Stored:
        """One query. The statistics are up to a second old, of which a measurement of many seconds knows nothing."""
        from sqlalchemy import create_engine, text

        engine = create_engine(self._url)
        try:
            with engine.connect() as connection:
                rows, size, log = connection.execute(text(self._QUERY)).one()
        finally:
            engine.dispose()
        return Stored(float(rows), float(size), float(log))


def cost_per_frame(used: Usage, tally: Tally) -> Cost:
    """Usage over the frames that were answered."""
    frames = len(tally.seconds)
    if not frames:
        return Cost()

    def per_frame(value: float | None, scale: float = 1.0) -> float | None:
        return None if value is None else value * scale / frames

    return Cost(
        web_cpu_ms=per_frame(used.web_cpu_s, 1e3),
        worker_cpu_ms=per_frame(used.worker_cpu_s, 1e3),
        client_cpu_ms=per_frame(used.client_cpu_s, 1e3),
        rows=per_frame(used.rows),
        database_bytes=per_frame(used.database_bytes),
        log_bytes=per_frame(used.log_bytes),
        sent_bytes=per_frame(tally.sent_bytes),
        received_bytes=per_frame(tally.received_bytes),
    )


def cpu_s(pid: int) -> float:
    """Computing time of a process so far; 0 of one that is gone."""
    try:
        after_name = (_PROC / str(pid) / "stat").read_text().rpartition(")")[2].split()
    except OSError:  # it ended since it was listed
        return 0.0
    user, system = int(after_name[11]), int(after_name[12])
    return (user + system) / os.sysconf("SC_CLK_TCK")


def descendants(pid: int) -> Iterator[int]:
    """All processes that a process started, and those that these started."""
    children: dict[int, list[int]] = {}
    for folder in _PROC.iterdir():
        if folder.name.isdigit():
            try:
                parent = int((folder / "stat").read_text().rpartition(")")[2].split()[1])
            except OSError:  # it ended since the folder was listed
                continue
            children.setdefault(parent, []).append(int(folder.name))
    waiting = list(children.get(pid, ()))
    while waiting:
        found = waiting.pop()
        yield found
        waiting += children.get(found, ())


def written_bytes(pid: int) -> float | None:
    """What a process has written to disk; None where the system does not say."""
    try:
        text = (_PROC / str(pid) / "io").read_text()
    except OSError:
        return None
    return float(next(line.split()[1] for line in text.splitlines() if line.startswith("write_bytes")))


def _own_cpu_s() -> float:
    times = os.times()
    return times.user + times.system

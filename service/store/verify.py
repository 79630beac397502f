"""All of a database looked at: every checksum, what belongs to nothing, what is missing in a sequence.

Reads on one snapshot, whatever release of this program or an earlier one wrote it, and changes nothing.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

from sqlalchemy import JSON, Column, Connection, Table, Text, cast, func, inspect, select

from service.errors import StorageError
from service.store.database import NEWEST_REVISION, revision
from service.store.seal import CHECKSUM, intact, is_sealed, row_name
from service.store.sessions import status_of
from service.store.tables import estimates, events, frames, metadata, particles, sessions

Tell = Callable[[str], None]
Span = tuple[int, int | None, int | None]  # how many, the first, the last
_AT_ONCE = 100  # rows in memory: each may hold a file of some megabytes


@dataclass(frozen=True)
class Verified:
    """What there was: sessions, frames, all rows that can have a checksum, those that have none, problems told."""

    sessions: int
    frames: int
    rows: int
    unsealed: int
    problems: int


def verify(connection: Connection, tell: Tell) -> Verified:
    """Look at everything; ``tell`` gets a line for each problem.

    Raises ``StorageError`` for what is no database of this program, or one of a newer release.
    """
    found = revision(connection)
    if found is None or found > NEWEST_REVISION:
        raise StorageError("this is no database of this release or an earlier one")
    present = _present(connection)
    tables = [table for table in metadata.sorted_tables if table.name in present]
    problems = rows = unsealed = 0
    for line in _problems(connection, tables):
        problems += 1
        tell(line)
    for table in filter(is_sealed, tables):
        if CHECKSUM not in present[table.name]:  # an earlier release's
            rows += _count(connection, table)
            unsealed += _count(connection, table)
            continue
        for name, whole in _rows(connection, table):
            rows += 1
            unsealed += whole is None
            if whole is False:
                problems += 1
                tell(f"{name} is not as it was stored")
    return Verified(_count(connection, sessions), _count(connection, frames), rows, unsealed, problems)


def _present(connection: Connection) -> dict[str, set[str]]:
    """Tables and their columns as the database has them."""
    there = inspect(connection)
    return {name: {column["name"] for column in there.get_columns(name)} for name in there.get_table_names()}


def _count(connection: Connection, table: Table) -> int:
    return int(connection.execute(select(func.count()).select_from(table)).scalar_one())


def _problems(connection: Connection, tables: Sequence[Table]) -> Iterator[str]:
    """What is wrong with the file, between rows, and in sequences."""
    if connection.dialect.name == "sqlite":
        yield from (line for line in connection.exec_driver_sql("PRAGMA integrity_check").scalars() if line != "ok")
    for table in tables:
        yield from _foreign(connection, table)
    yield from _gaps(connection)


def _foreign(connection: Connection, table: Table) -> Iterator[str]:
    """Rows that name a row which is not there. PostgreSQL lets none in; SQLite does where it was told to."""
    for key in table.foreign_keys:
        own: Column[Any] = key.parent
        there = select(key.column).where(key.column == own).exists()
        query = select(own, func.count()).where(own.is_not(None), ~there).group_by(own)
        for named, count in connection.execute(query):
            yield f"{table.name}: {count} with {own.name} {named}, which is not in {key.column.table.name}"


def _gaps(connection: Connection) -> Iterator[str]:
    spans = {table.name: _spans(connection, table, column) for table, column in _SEQUENCES}
    columns = (sessions.c.id, sessions.c.next_index, sessions.c.next_seq, sessions.c.time_s, sessions.c.status)
    for session_id, next_index, next_seq, time_s, status in connection.execute(select(*columns)):
        for name, first, after in (("frames", 0, next_index), ("estimates", 0, next_index), ("events", 1, next_seq)):
            wanted = (after - first, first, after - 1) if after > first else (0, None, None)
            found = spans[name].get(session_id, (0, None, None))
            if found != wanted:
                yield f"session {session_id}: {name} {_told(wanted)} are wanted, {_told(found)} found"
        if next_index:
            yield from _unlike_its_last(connection, session_id, next_index - 1, time_s, status)
    shown = (estimates.c.session_id == events.c.session_id) & (estimates.c.idx == events.c.idx)
    lost = select(events.c.session_id, events.c.seq).join(estimates, shown, isouter=True)
    for session_id, seq in connection.execute(lost.where(estimates.c.idx.is_(None))):
        yield f"session {session_id}: event {seq} is of no estimate"


def _unlike_its_last(connection: Connection, session_id: str, last: int, time_s: float, status: str) -> Iterator[str]:
    at = select(frames.c.time_s).where(frames.c.session_id == session_id, frames.c.idx == last)
    if connection.execute(at).scalar() not in (time_s, None):
        yield f"session {session_id}: its time is not that of its last frame"
    told = select(estimates.c.document).where(estimates.c.session_id == session_id, estimates.c.idx == last)
    document = connection.execute(told).scalar()
    if document is not None and status_of(document) not in (None, status):
        yield f"session {session_id}: its status is not that of its last estimate"
    state = select(particles.c.idx).where(particles.c.session_id == session_id, particles.c.idx == last)
    if connection.execute(state).first() is None:
        yield f"session {session_id}: its state, the particles of frame {last}, is missing"


def _told(span: Span) -> str:
    count, first, last = span
    return f"{first} to {last} ({count})" if count else "none"


_SEQUENCES = ((frames, frames.c.idx), (estimates, estimates.c.idx), (events, events.c.seq))


def _spans(connection: Connection, table: Table, column: Column[Any]) -> dict[str, Span]:
    query = select(table.c.session_id, func.count(), func.min(column), func.max(column)).group_by(table.c.session_id)
    return {session_id: (count, first, last) for session_id, count, first, last in connection.execute(query)}


def _rows(connection: Connection, table: Table) -> Iterator[tuple[str, bool | None]]:
    """Name of each row, and whether it is as it was stored. Documents come as text: damaged ones can be no JSON."""
    documents = [column for column in table.c if isinstance(column.type, JSON)]
    columns = [cast(column, Text) if isinstance(column.type, JSON) else column for column in table.c]
    for row in connection.execute(select(*columns).execution_options(yield_per=_AT_ONCE)):
        values = dict(zip(table.c, row, strict=True))
        name = row_name(table, values)
        try:
            values |= {c: json.loads(values[c]) for c in documents if values[c] is not None}
        except ValueError:
            yield name, False
        else:
            yield name, intact(table, values)

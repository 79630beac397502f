"""Queries on frames: the one transaction that makes a frame true, and what reads it back."""

from __future__ import annotations

import functools
from collections.abc import Collection, Mapping
from typing import Any

from sqlalchemy import BindParameter, Connection, Insert, Table, bindparam, delete, insert, select

from service.errors import GoneError, NotFoundError
from service.store import sessions as session_queries
from service.store.base import FrameRecord, Retention, StoredBelief, StoredEvent, StoredFrame
from service.store.scope import SessionKey
from service.store.seal import CHECKSUM, checked, sealed
from service.store.tables import beliefs, estimates, events, frame_bodies, frames, particles, sessions

_BEFORE: BindParameter[int] = bindparam("before")
_MINE: BindParameter[str] = bindparam("of_session")
_EVERY: BindParameter[int] = bindparam("every")
_NAMED = (frames.c.idx == bindparam("at")) | (frames.c.idempotency_key == bindparam("under"))  # of NULL: none
_FIND = (
    select(sessions.c.epoch.label("owned"), frames)
    .select_from(sessions.outerjoin(frames, (frames.c.session_id == sessions.c.id) & _NAMED))
    .where(sessions.c.id == _MINE)
)
_OLD_BODIES = delete(frame_bodies).where(frame_bodies.c.session_id == _MINE, frame_bodies.c.idx <= _BEFORE)
_OLD_SETS = delete(particles).where(particles.c.session_id == _MINE, particles.c.idx <= _BEFORE)
_OLD_SETS_BUT_SOME = _OLD_SETS.where(particles.c.idx % _EVERY != 0)


def append(connection: Connection, record: FrameRecord, retention: Retention) -> int:
    """Store a frame, its estimate, its particles and its event; drop what retention no longer keeps.

    Returns the event's number. Raises ``StaleOwnerError`` unless ``record.epoch`` is the present owner's and
    ``record.index`` the next.
    """
    seq = session_queries.take_turn(connection, record)
    at = {"session_id": record.session_id, "idx": record.index}
    names = set(map(str, frames.c.keys())) - {"idx", CHECKSUM}
    values = {**at, **{name: getattr(record, name) for name in names}, "query": dict(record.query)}
    _put(connection, frames, values)
    if retention.frame_bodies:
        _put(connection, frame_bodies, {**at, "body": record.body})
    _put(connection, estimates, {**at, "document": record.document})
    _put(connection, particles, {**at, "state": record.state})
    if record.belief is not None:
        _put(connection, beliefs, {**at, "belief": record.belief})
    session_queries.put_contenders(connection, record.session_id, record.contenders)
    _put(connection, events, {**at, "seq": seq, "kind": "estimate"})
    _forget(connection, record.session_id, record.index, retention)
    return seq


def _put(connection: Connection, table: Table, values: Mapping[str, Any]) -> None:
    connection.execute(_insert(table), sealed(table, values))


@functools.cache
def _insert(table: Table) -> Insert:
    """Kept, as ``_OLD_BODIES`` is: to build a statement takes as long as to run it."""
    return insert(table)


def _forget(connection: Connection, session_id: SessionKey, newest: int, retention: Retention) -> None:
    connection.execute(_OLD_BODIES, {"of_session": session_id, "before": newest - retention.frame_bodies})
    sets = {"of_session": session_id, "before": newest - retention.particle_sets}
    if retention.particle_every:
        connection.execute(_OLD_SETS_BUT_SOME, {**sets, "every": retention.particle_every})
    else:
        connection.execute(_OLD_SETS, sets)


def find(
    connection: Connection, session_id: SessionKey, *, index: int | None, key: str | None, epoch: int | None = None
) -> tuple[StoredFrame | None, StoredFrame | None]:
    """The stored frames at this index and under this idempotency key; None where there is none.

    Raises ``StaleOwnerError`` for an ``epoch`` that is not the present owner's.
    """
    rows = connection.execute(_FIND, {"of_session": session_id, "at": index, "under": key}).all()
    if epoch is not None and (not rows or rows[0].owned != epoch):
        raise session_queries.stale(session_id)
    found = [
        StoredFrame(checked(frames, row).idx, row.sha256, row.idempotency_key) for row in rows if row.idx is not None
    ]
    at_index = (one for one in found if one.index == index)
    under_key = (one for one in found if key is not None and one.idempotency_key == key)
    return next(at_index, None), next(under_key, None)


def estimate(connection: Connection, session_id: SessionKey, index: int | None) -> bytes:
    """The estimate at ``index`` (None: the newest), as stored. Raises ``NotFoundError``."""
    query = select(estimates).where(estimates.c.session_id == session_id)
    query = query.order_by(estimates.c.idx.desc()) if index is None else query.where(estimates.c.idx == index)
    row = connection.execute(query.limit(1)).first()
    if row is None:
        session_queries.get(connection, session_id)
        raise NotFoundError("no estimate yet" if index is None else f"no estimate {index}", field="index")
    document: bytes = checked(estimates, row).document
    return document


def estimate_page(connection: Connection, session_id: SessionKey, after: int, limit: int) -> list[tuple[int, bytes]]:
    """Index and document of estimates after index ``after``. Raises ``NotFoundError``: no such session."""
    session_queries.get(connection, session_id)
    query = (
        select(estimates)
        .where(estimates.c.session_id == session_id, estimates.c.idx > after)
        .order_by(estimates.c.idx)
        .limit(limit)
    )
    return [(row.idx, checked(estimates, row).document) for row in connection.execute(query)]


def span(connection: Connection, session_id: SessionKey) -> tuple[str, str] | None:
    """Times of a session's first and last frame; None: it has none."""
    mine = select(frames).where(frames.c.session_id == session_id).limit(1)
    first = connection.execute(mine.order_by(frames.c.idx)).first()
    last = connection.execute(mine.order_by(frames.c.idx.desc())).first()
    return None if first is None or last is None else (checked(frames, first).time, checked(frames, last).time)


def belief_page(connection: Connection, session_id: SessionKey, first: int) -> list[StoredBelief]:
    """Time and packed modes of frame ``first`` and all after it. Raises ``NotFoundError``: no such session."""
    session_queries.get(connection, session_id)
    same = (beliefs.c.session_id == frames.c.session_id) & (beliefs.c.idx == frames.c.idx)
    query = (
        select(frames, beliefs)
        .join(beliefs, same, isouter=True)
        .where(frames.c.session_id == session_id, frames.c.idx >= first)
        .order_by(frames.c.idx)
    )
    found = []
    for row in connection.execute(query):
        if row.belief is not None:
            checked(beliefs, row)
        found.append(StoredBelief(row.idx, checked(frames, row).time_s, row.belief))
    return found


def event_page(connection: Connection, session_id: SessionKey, after: int, limit: int) -> list[StoredEvent]:
    """Events numbered after ``after``, with their estimates."""
    query = (
        select(events, estimates)
        .join(estimates, (estimates.c.session_id == events.c.session_id) & (estimates.c.idx == events.c.idx))
        .where(events.c.session_id == session_id, events.c.seq > after)
        .order_by(events.c.seq)
        .limit(limit)
    )
    rows = [checked(estimates, checked(events, row)) for row in connection.execute(query)]
    return [StoredEvent(row.seq, row.document) for row in rows]


def last_seq(connection: Connection, session_id: SessionKey) -> int:
    """Number of the newest event (0: none yet). Raises ``NotFoundError``."""
    return session_queries.get(connection, session_id).next_seq - 1


def last_seqs(connection: Connection, session_ids: Collection[SessionKey]) -> dict[SessionKey, int]:
    """The same of several; those that are unknown are left out."""
    query = select(sessions.c.id, sessions.c.next_seq).where(sessions.c.id.in_(session_ids))
    return {SessionKey(row.id): row.next_seq - 1 for row in connection.execute(query)}


def body(connection: Connection, session_id: SessionKey, index: int) -> tuple[bytes, str]:
    """File and media type of a frame. Raises ``NotFoundError``, ``GoneError`` where it is not kept."""
    at = (frames.c.session_id == session_id, frames.c.idx == index)
    frame = connection.execute(select(frames).where(*at)).first()
    if frame is None:
        session_queries.get(connection, session_id)
        raise NotFoundError(f"no frame {index}", field="index")
    query = select(frame_bodies).where(frame_bodies.c.session_id == session_id, frame_bodies.c.idx == index)
    row = connection.execute(query).first()
    if row is None:
        raise GoneError(
            f"the file of frame {index} is no longer kept", field="index", setting="SKYPOSE_KEEP_FRAME_BODIES"
        )
    return checked(frame_bodies, row).body, checked(frames, frame).media_type


def particle_set(connection: Connection, session_id: SessionKey, index: int | None) -> tuple[int, bytes]:
    """Index and packed state (None: the newest). Raises ``NotFoundError`` or ``GoneError``."""
    record = session_queries.get(connection, session_id)
    wanted = record.next_index - 1 if index is None else index
    if not 0 <= wanted < record.next_index:
        raise NotFoundError("no frame yet" if index is None else f"no frame {index}", field="index")
    state = session_queries.state(connection, session_id, wanted)
    if state is None:
        raise GoneError(
            f"the particles of frame {wanted} are no longer kept",
            field="index",
            setting="SKYPOSE_KEEP_PARTICLE_SETS",
        )
    return wanted, state

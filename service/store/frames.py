"""Queries on frames: the one transaction that makes a frame true, and what reads it back."""

from __future__ import annotations

from collections.abc import Collection

from sqlalchemy import Connection, delete, insert, select

from service.errors import GoneError, NotFoundError
from service.store import sessions as session_queries
from service.store.base import FrameRecord, Retention, StoredBelief, StoredEvent, StoredFrame
from service.store.scope import SessionKey
from service.store.tables import beliefs, estimates, events, frame_bodies, frames, particles, sessions


def append(connection: Connection, record: FrameRecord, retention: Retention) -> int:
    """Store a frame, its estimate, its particles and its event; drop what retention no longer keeps.

    Returns the event's number. Raises ``StaleOwnerError`` unless ``record.epoch`` is the present owner's and
    ``record.index`` the next.
    """
    row = session_queries.get(connection, record.session_id, hold=True)
    session_queries.advance(
        connection,
        record.session_id,
        record.epoch if row.next_index == record.index else -1,
        next_index=record.index + 1,
        next_seq=row.next_seq + 1,
        status=record.status,
        time_s=record.time_s,
        time_given=record.time_given,
        updated_at=record.created_at,
    )
    values = {name: getattr(record, name) for name in frames.columns.keys() if name != "idx"}  # noqa: SIM118
    connection.execute(insert(frames).values(idx=record.index, **{**values, "query": dict(record.query)}))
    at = {"session_id": record.session_id, "idx": record.index}
    if retention.frame_bodies:
        connection.execute(insert(frame_bodies).values(**at, body=record.body))
    connection.execute(insert(estimates).values(**at, document=record.document))
    connection.execute(insert(particles).values(**at, state=record.state))
    if record.belief is not None:
        connection.execute(insert(beliefs).values(**at, belief=record.belief))
    session_queries.put_contenders(connection, record.session_id, record.contenders)
    connection.execute(insert(events).values(**at, seq=row.next_seq, kind="estimate"))
    _forget(connection, record.session_id, record.index, retention)
    return row.next_seq


def _forget(connection: Connection, session_id: SessionKey, newest: int, retention: Retention) -> None:
    old_bodies = frame_bodies.c.idx <= newest - retention.frame_bodies
    connection.execute(delete(frame_bodies).where(frame_bodies.c.session_id == session_id, old_bodies))
    old_sets = particles.c.idx <= newest - retention.particle_sets
    query = delete(particles).where(particles.c.session_id == session_id, old_sets)
    if retention.particle_every:
        query = query.where(particles.c.idx % retention.particle_every != 0)
    connection.execute(query)


def find(
    connection: Connection, session_id: SessionKey, *, index: int | None, key: str | None, epoch: int | None = None
) -> tuple[StoredFrame | None, StoredFrame | None]:
    """The stored frames at this index and under this idempotency key; None where there is none.

    Raises ``StaleOwnerError`` for an ``epoch`` that is not the present owner's.
    """
    if epoch is not None:
        session_queries.require_owner(connection, session_id, epoch)

    def one(column: object, value: object) -> StoredFrame | None:
        if value is None:
            return None
        query = select(frames.c.idx, frames.c.sha256, frames.c.idempotency_key)
        row = connection.execute(query.where(frames.c.session_id == session_id, column == value)).first()  # type: ignore[arg-type]
        return None if row is None else StoredFrame(row.idx, row.sha256, row.idempotency_key)

    return one(frames.c.idx, index), one(frames.c.idempotency_key, key)


def estimate(connection: Connection, session_id: SessionKey, index: int | None) -> bytes:
    """The estimate at ``index`` (None: the newest), as stored. Raises ``NotFoundError``."""
    query = select(estimates.c.document).where(estimates.c.session_id == session_id)
    query = query.order_by(estimates.c.idx.desc()) if index is None else query.where(estimates.c.idx == index)
    document: bytes | None = connection.execute(query.limit(1)).scalar()
    if document is None:
        session_queries.get(connection, session_id)
        raise NotFoundError("no estimate yet" if index is None else f"no estimate {index}", field="index")
    return document


def estimate_page(connection: Connection, session_id: SessionKey, after: int, limit: int) -> list[tuple[int, bytes]]:
    """Index and document of estimates after index ``after``. Raises ``NotFoundError``: no such session."""
    session_queries.get(connection, session_id)
    query = (
        select(estimates.c.idx, estimates.c.document)
        .where(estimates.c.session_id == session_id, estimates.c.idx > after)
        .order_by(estimates.c.idx)
        .limit(limit)
    )
    return [(row.idx, row.document) for row in connection.execute(query)]


def belief_page(connection: Connection, session_id: SessionKey, first: int) -> list[StoredBelief]:
    """Time and packed modes of frame ``first`` and all after it. Raises ``NotFoundError``: no such session."""
    session_queries.get(connection, session_id)
    same = (beliefs.c.session_id == frames.c.session_id) & (beliefs.c.idx == frames.c.idx)
    query = (
        select(frames.c.idx, frames.c.time_s, beliefs.c.belief)
        .join(beliefs, same, isouter=True)
        .where(frames.c.session_id == session_id, frames.c.idx >= first)
        .order_by(frames.c.idx)
    )
    return [StoredBelief(row.idx, row.time_s, row.belief) for row in connection.execute(query)]


def event_page(connection: Connection, session_id: SessionKey, after: int, limit: int) -> list[StoredEvent]:
    """Events numbered after ``after``, with their estimates."""
    query = (
        select(events.c.seq, estimates.c.document)
        .join(estimates, (estimates.c.session_id == events.c.session_id) & (estimates.c.idx == events.c.idx))
        .where(events.c.session_id == session_id, events.c.seq > after)
        .order_by(events.c.seq)
        .limit(limit)
    )
    return [StoredEvent(row.seq, row.document) for row in connection.execute(query)]


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
    media_type: str | None = connection.execute(select(frames.c.media_type).where(*at)).scalar()
    if media_type is None:
        session_queries.get(connection, session_id)
        raise NotFoundError(f"no frame {index}", field="index")
    query = select(frame_bodies.c.body).where(frame_bodies.c.session_id == session_id, frame_bodies.c.idx == index)
    data: bytes | None = connection.execute(query).scalar()
    if data is None:
        raise GoneError(
            f"the file of frame {index} is no longer kept", field="index", setting="SKYPOSE_KEEP_FRAME_BODIES"
        )
    return data, media_type


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

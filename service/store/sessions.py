"""Queries on sessions and their backgrounds."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import orjson
from sqlalchemy import ColumnElement, Connection, Row, bindparam, delete, func, insert, select, update

from service.errors import DamagedError, NotFoundError, QuotaExceededError, StaleOwnerError
from service.store import instances, models
from service.store.base import (
    NO_QUOTAS,
    BackgroundRecord,
    FrameRecord,
    Page,
    Quotas,
    SessionRecord,
    SessionStamp,
    StoredContender,
)
from service.store.instances import Instance
from service.store.pages import page_of
from service.store.scope import SessionKey, public_id
from service.store.seal import checked, record_values, row_of, sealed
from service.store.signals import Signal, alone, send
from service.store.tables import backgrounds, contenders, estimates, frames, particles, sessions

_TURN = (
    update(sessions)
    .where(
        sessions.c.id == bindparam("its_session_id"),
        sessions.c.epoch == bindparam("its_epoch"),
        sessions.c.next_index == bindparam("its_index"),
    )
    .values(
        next_index=sessions.c.next_index + 1,
        next_seq=sessions.c.next_seq + 1,
        status=bindparam("its_status"),
        time_s=bindparam("its_time_s"),
        time_given=bindparam("its_time_given"),
        updated_at=bindparam("its_created_at"),
    )
    .returning(sessions.c.next_seq)
)


def add(connection: Connection, record: SessionRecord, quotas: Quotas = NO_QUOTAS) -> None:
    """Store a new session. Raises ``NotFoundError`` where its model has gone, ``QuotaExceededError``."""
    alone(connection)
    models.get(connection, record.model_id)
    _require_room(connection, record, quotas)
    values = {**row_of(sessions, record), "warnings": list(record.warnings)}
    connection.execute(insert(sessions), sealed(sessions, values))
    for model_id in record.model_ids:
        models.get(connection, model_id)
    put_contenders(connection, record.id, [StoredContender(model_id, None, 0.0) for model_id in record.model_ids])


def _require_room(connection: Connection, record: SessionRecord, quotas: Quotas) -> None:
    count, particle_sum = holdings(connection, record.tenant)
    wanted = int(record.config.get("filter", {}).get("particles", 0))
    if quotas.sessions and count >= quotas.sessions:
        raise QuotaExceededError(f"{count} sessions are there", limit=quotas.sessions, setting="SKYPOSE_QUOTA_SESSIONS")
    if quotas.particles and particle_sum + wanted > quotas.particles:
        raise QuotaExceededError(
            f"its sessions have {particle_sum} particles, and this one asks for {wanted}",
            limit=quotas.particles,
            setting="SKYPOSE_QUOTA_PARTICLES",
        )


def get(connection: Connection, session_id: SessionKey, *, hold: bool = False) -> SessionRecord:
    """The session; with ``hold`` its row is this transaction's until that ends. Raises ``NotFoundError``."""
    query = select(sessions).where(sessions.c.id == session_id)
    row = connection.execute(query.with_for_update() if hold else query).first()
    if row is None:
        raise unknown(session_id)
    return _with_models(connection, _record(row))


def page(connection: Connection, tenant: str, after: int, limit: int) -> Page[SessionRecord]:
    """A tenant's sessions in order of creation, from number ``after`` on."""
    return page_of(connection, sessions, get, tenant, after, limit)


def holdings(connection: Connection, tenant: str) -> tuple[int, int]:
    """How many sessions a tenant has, and how many particles they have together."""
    particles_each = sessions.c.config["filter"]["particles"].as_integer()
    query = select(func.count(), func.coalesce(func.sum(particles_each), 0)).where(sessions.c.tenant == tenant)
    count, particle_sum = connection.execute(query).one()
    return count, particle_sum


def claim(
    connection: Connection, session_id: SessionKey, me: str | None = None, gone: str | None = None
) -> tuple[SessionRecord, bytes | None] | Instance:
    """Become the session's owner: raise its epoch, and read it with its newest packed state.

    Where several processes share the database ``me`` names this one, and the answer is the other that has the session,
    if its lease lasts; ``gone`` names one that is to be taken for dead.
    """
    record = get(connection, session_id, hold=True)
    _require_whole(connection, record)
    if me is not None:
        owner = instances.owner(connection, session_id)
        if owner is not None and owner.id not in (me, gone):
            return owner
        instances.assign(connection, session_id, me)
    connection.execute(update(sessions).where(sessions.c.id == session_id).values(epoch=record.epoch + 1))
    record = replace(record, epoch=record.epoch + 1)
    return record, state(connection, session_id, record.next_index - 1)


def _require_whole(connection: Connection, record: SessionRecord) -> None:
    """Raises ``DamagedError`` where what no checksum holds, count, time and status, is not that of the last frame."""
    query = select(frames.c.idx, frames.c.time_s).where(frames.c.session_id == record.id)
    last = connection.execute(query.order_by(frames.c.idx.desc()).limit(1)).first()
    fits = (record.next_index - 1, record.time_s) == ((-1, record.time_s) if last is None else tuple(last))
    told = None if last is None else last_status(connection, record.id, last.idx)
    if not fits or told not in (None, record.status):
        raise DamagedError(f"session {public_id(record.id)} and its frames do not fit together")


def last_status(connection: Connection, session_id: SessionKey, index: int) -> str | None:
    """The status that an estimate tells; None where it cannot be read. Raises ``DamagedError`` for a changed one."""
    query = select(estimates).where(estimates.c.session_id == session_id, estimates.c.idx == index)
    row = connection.execute(query).first()
    return None if row is None else status_of(checked(estimates, row).document)


def status_of(document: bytes) -> str | None:
    """The status in a stored estimate; None where it cannot be read."""
    try:
        found = orjson.loads(document)
    except orjson.JSONDecodeError:
        return None
    return found.get("status") if isinstance(found, dict) else None


def unknown(session_id: SessionKey) -> NotFoundError:
    """The error of a session that is not there."""
    return NotFoundError(f"no session {public_id(session_id)}", field="session_id")


def stale(session_id: SessionKey) -> StaleOwnerError:
    """The error of an owner that is none any more."""
    return StaleOwnerError(f"session {public_id(session_id)} was deleted or has another owner")


def state(connection: Connection, session_id: SessionKey, index: int) -> bytes | None:
    """The packed state after frame ``index``, or None where none is kept."""
    query = select(particles).where(particles.c.session_id == session_id, particles.c.idx == index)
    row = connection.execute(query).first()
    return None if row is None else checked(particles, row).state


def compared(connection: Connection, session_id: SessionKey) -> list[StoredContender]:
    """The models that a session compares, in its order; none for a plain session."""
    query = select(contenders).where(contenders.c.session_id == session_id).order_by(contenders.c.ordinal)
    rows = [checked(contenders, row) for row in connection.execute(query)]
    return [StoredContender(row.model_id, row.state, row.log_evidence) for row in rows]


def put_contenders(connection: Connection, session_id: SessionKey, given: Sequence[StoredContender]) -> None:
    """Store the compared models in place of their earlier stand; nothing to do where there are none."""
    if given:
        connection.execute(delete(contenders).where(contenders.c.session_id == session_id))
    for ordinal, one in enumerate(given):
        values = {"model_id": one.model_id, "state": one.state, "log_evidence": one.log_evidence}
        row = sealed(contenders, {"session_id": session_id, "ordinal": ordinal, **values})
        connection.execute(insert(contenders), row)


def stamps(connection: Connection) -> list[SessionStamp]:
    """When each session, of any tenant, was last used and ended."""
    query = select(sessions.c.id, sessions.c.updated_at, sessions.c.ended_at).order_by(sessions.c.number)
    return [SessionStamp(row.id, row.updated_at, row.ended_at) for row in connection.execute(query)]


def end(connection: Connection, stamp: SessionStamp, now: str) -> bool:
    """End a session, unless it was used since or has ended. Its owner can write no more. Returns whether it did."""
    values = {"ended_at": now, "epoch": sessions.c.epoch + 1}
    return connection.execute(update(sessions).where(*_unchanged(stamp)).values(values)).rowcount == 1


def _unchanged(stamp: SessionStamp) -> tuple[ColumnElement[bool], ...]:
    since = (sessions.c.updated_at == stamp.updated_at, sessions.c.ended_at.is_not_distinct_from(stamp.ended_at))
    return sessions.c.id == stamp.id, *since


def remove(connection: Connection, session_id: SessionKey, stamp: SessionStamp | None = None) -> None:
    """Delete a session with all its history; with ``stamp`` only while that is true. Raises ``NotFoundError``."""
    alone(connection)
    query = select(sessions.c.background_key).where(sessions.c.id == session_id).with_for_update()
    if stamp is not None:
        query = query.where(*_unchanged(stamp))
    row = connection.execute(query).first()  # not ``get``: what is damaged can be deleted
    if row is None:
        raise unknown(session_id)
    connection.execute(delete(sessions).where(sessions.c.id == session_id))
    models.drop_blob_if_unused(connection, row.background_key)
    send(connection, Signal("deleted", session_id))


def advance(connection: Connection, session_id: SessionKey, epoch: int, **values: Any) -> None:
    """Update the row in the name of an owner. Raises ``StaleOwnerError`` for any but the present."""
    query = update(sessions).where(sessions.c.id == session_id, sessions.c.epoch == epoch).values(**values)
    if connection.execute(query).rowcount != 1:
        raise stale(session_id)


def take_turn(connection: Connection, record: FrameRecord) -> int:
    """The number of a frame's event; its session's row is this transaction's, and goes on to the next frame.

    Raises ``StaleOwnerError`` unless ``record.epoch`` is the present owner's and ``record.index`` the next.
    """
    names = "session_id", "epoch", "index", "status", "time_s", "time_given", "created_at"
    taken = connection.execute(_TURN, {f"its_{name}": getattr(record, name) for name in names}).scalar()
    if taken is None:
        raise stale(record.session_id)
    return int(taken) - 1


def find_background(connection: Connection, session_id: SessionKey, idempotency_key: str) -> tuple[str, int] | None:
    """SHA-256 and frame count of the background call that used this key, or None."""
    query = select(backgrounds).where(
        backgrounds.c.session_id == session_id, backgrounds.c.idempotency_key == idempotency_key
    )
    row = connection.execute(query).first()
    return None if row is None else (checked(backgrounds, row).sha256, row.frames)


def set_background(connection: Connection, record: BackgroundRecord) -> None:
    """Store the background after one more image, and let go of the one before."""
    alone(connection)
    old = get(connection, record.session_id, hold=True).background_key
    models.put_blob(connection, record.key, record.data)
    advance(
        connection,
        record.session_id,
        record.epoch,
        background_key=record.key,
        background_frames=record.frames,
        background_info=dict(record.info),
        updated_at=record.created_at,
    )
    if old != record.key:
        models.drop_blob_if_unused(connection, old)
    count = select(func.count()).where(backgrounds.c.session_id == record.session_id)
    values = {
        "session_id": record.session_id,
        "ordinal": connection.execute(count).scalar_one(),
        "sha256": record.sha256,
        "idempotency_key": record.idempotency_key,
        "frames": record.frames,
        "created_at": record.created_at,
    }
    connection.execute(insert(backgrounds), sealed(backgrounds, values))


def _record(row: Row[Any]) -> SessionRecord:
    values = record_values(checked(sessions, row))
    return SessionRecord(**{**values, "warnings": tuple(values["warnings"])})


def _with_models(connection: Connection, record: SessionRecord) -> SessionRecord:
    query = select(contenders.c.model_id).where(contenders.c.session_id == record.id).order_by(contenders.c.ordinal)
    return replace(record, model_ids=tuple(connection.execute(query).scalars()))

"""A whole session read out, and put back in another database."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

from sqlalchemy import Connection, Table, delete, insert, select

from service.errors import ConflictError
from service.store import models, sessions
from service.store.base import NO_QUOTAS, ModelRecord, Quotas, SessionRecord, StoredContender
from service.store.scope import SessionKey, public_id
from service.store.seal import checked, record_values, sealed
from service.store.signals import Signal, alone, send
from service.store.tables import backgrounds, estimates, events, frames, particles
from service.store.tables import sessions as sessions_table

Rows = Sequence[dict[str, Any]]


@dataclass(frozen=True)
class ComparedModel:
    """One of the models that a session compares, with its posterior."""

    model: ModelRecord
    file: bytes
    contender: StoredContender


@dataclass(frozen=True)
class StoredSession:
    """A session with its model, its newest particles and its history (no frame files, no older particles)."""

    record: SessionRecord
    model: ModelRecord
    model_file: bytes
    background: bytes | None
    state: bytes | None
    backgrounds: Rows
    frames: Rows
    estimates: Rows
    events: Rows
    compared: Sequence[ComparedModel] = ()  # in the session's order, ``model`` the first; none for a plain session


def read(connection: Connection, session_id: SessionKey) -> StoredSession:
    """The session as it stands. Raises ``NotFoundError``."""
    record = sessions.get(connection, session_id)
    model = models.get(connection, record.model_id)
    key = record.background_key
    return StoredSession(
        record=record,
        model=model,
        model_file=models.get_blob(connection, model.blob_key),
        background=None if key is None else models.get_blob(connection, key),
        state=sessions.state(connection, session_id, record.next_index - 1),
        backgrounds=_rows(connection, backgrounds, session_id),
        frames=_rows(connection, frames, session_id),
        estimates=_rows(connection, estimates, session_id),
        events=_rows(connection, events, session_id),
        compared=[_compared(connection, one) for one in sessions.compared(connection, session_id)],
    )


def _compared(connection: Connection, one: StoredContender) -> ComparedModel:
    model = models.get(connection, one.model_id)
    return ComparedModel(model, models.get_blob(connection, model.blob_key), one)


def write(connection: Connection, given: StoredSession, quotas: Quotas = NO_QUOTAS) -> bool:
    """Put the session in, in place of an earlier stand of the same one. Returns whether it is new here.

    Raises ``ConflictError`` where the stored session is another one or has gone further, ``QuotaExceededError``.
    """
    record = given.record
    alone(connection)
    old = _earlier(connection, given)
    models.add(connection, given.model, given.model_file, quotas)
    for one in given.compared:
        models.add(connection, one.model, one.file, quotas)
    if given.background is not None and record.background_key is not None:
        models.put_blob(connection, record.background_key, given.background)
    if old is not None:
        connection.execute(delete(sessions_table).where(sessions_table.c.id == record.id))
        if old.background_key != record.background_key:
            models.drop_blob_if_unused(connection, old.background_key)
        record = replace(record, epoch=old.epoch + 1)  # whoever owned it can write no more
    sessions.add(connection, record, quotas)
    sessions.put_contenders(connection, record.id, [one.contender for one in given.compared])
    for table, rows in (
        (backgrounds, given.backgrounds),
        (frames, given.frames),
        (estimates, given.estimates),
        (events, given.events),
    ):
        if rows:
            connection.execute(insert(table), [sealed(table, {**row, "session_id": record.id}) for row in rows])
    if given.state is not None:
        newest = {"session_id": record.id, "idx": record.next_index - 1, "state": given.state}
        connection.execute(insert(particles), sealed(particles, newest))
    send(connection, Signal("replaced", record.id, record.next_seq - 1))
    return old is None


def _earlier(connection: Connection, given: StoredSession) -> SessionRecord | None:
    query = select(sessions_table.c.id).where(sessions_table.c.id == given.record.id).with_for_update()
    if connection.execute(query).first() is None:
        return None
    old = sessions.get(connection, given.record.id)
    mine = {row["idx"]: row["sha256"] for row in _rows(connection, frames, old.id)}
    theirs = {row["idx"]: row["sha256"] for row in given.frames}
    same = (old.model_id, old.model_ids) == (given.record.model_id, given.record.model_ids)
    if not same or not mine.items() <= theirs.items():
        raise ConflictError(
            f"session {public_id(old.id)} is here with other frames, or further on",
            field="session_id",
            frames=old.next_index,
            frames_in_checkpoint=given.record.next_index,
        )
    return old


def _rows(connection: Connection, table: Table, session_id: SessionKey) -> list[dict[str, Any]]:
    query = select(table).where(table.c.session_id == session_id).order_by(*table.primary_key.columns)
    rows = [record_values(checked(table, row)) for row in connection.execute(query)]
    return [{name: row[name] for name in row if name != "session_id"} for row in rows]  # whose, the place tells

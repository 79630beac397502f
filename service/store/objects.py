"""Queries on objects: what several sessions are of."""

from __future__ import annotations

from dataclasses import replace

from sqlalchemy import Connection, delete, func, insert, select

from service.errors import NotFoundError, QuotaExceededError
from service.store import sessions as sessions_store
from service.store.base import ObjectRecord, Page
from service.store.pages import page_of
from service.store.scope import ObjectKey, SessionKey, public_id
from service.store.seal import checked, record_values, row_of, sealed
from service.store.signals import alone
from service.store.tables import members, objects, sessions


def add(connection: Connection, record: ObjectRecord, quota: int = 0) -> ObjectRecord:
    """Store a new object with its sessions. Raises ``NotFoundError`` for one that is not there.

    Raises ``QuotaExceededError`` where its tenant has ``quota`` (0: any number).
    """
    alone(connection)
    query = select(func.count()).where(objects.c.tenant == record.tenant)
    if quota and connection.execute(query).scalar_one() >= quota:
        raise QuotaExceededError(f"{quota} objects are there", limit=quota, setting="SKYPOSE_QUOTA_OBJECTS")
    connection.execute(insert(objects), sealed(objects, row_of(objects, record)))
    for session_id in dict.fromkeys(record.sessions):
        _insert(connection, record.id, session_id)
    return get(connection, record.id)


def get(connection: Connection, object_id: ObjectKey) -> ObjectRecord:
    """The object. Raises ``NotFoundError``."""
    row = connection.execute(select(objects).where(objects.c.id == object_id)).first()
    if row is None:
        raise _unknown(object_id)
    record = ObjectRecord(**record_values(checked(objects, row)))
    query = select(members).join(sessions, sessions.c.id == members.c.session_id)
    rows = connection.execute(query.where(members.c.object_id == object_id).order_by(sessions.c.number))
    return replace(record, sessions=tuple(checked(members, one).session_id for one in rows))


def page(connection: Connection, tenant: str, after: int, limit: int) -> Page[ObjectRecord]:
    """A tenant's objects in order of creation, from number ``after`` on."""
    return page_of(connection, objects, get, tenant, after, limit)


def join(connection: Connection, object_id: ObjectKey, session_id: SessionKey) -> ObjectRecord:
    """A session is of this object; once more changes nothing. Raises ``NotFoundError``."""
    alone(connection)
    if session_id not in get(connection, object_id).sessions:
        _insert(connection, object_id, session_id)
    return get(connection, object_id)


def leave(connection: Connection, object_id: ObjectKey, session_id: SessionKey) -> None:
    """It is of it no more. Raises ``NotFoundError`` where it was not."""
    alone(connection)
    query = delete(members).where(members.c.object_id == object_id, members.c.session_id == session_id)
    if not connection.execute(query).rowcount:
        raise sessions_store.unknown(session_id)


def remove(connection: Connection, object_id: ObjectKey) -> None:
    """Delete an object; its sessions stay. Raises ``NotFoundError``."""
    alone(connection)
    if not connection.execute(delete(objects).where(objects.c.id == object_id)).rowcount:
        raise _unknown(object_id)


def _insert(connection: Connection, object_id: ObjectKey, session_id: SessionKey) -> None:
    sessions_store.get(connection, session_id)
    connection.execute(insert(members), sealed(members, {"object_id": object_id, "session_id": session_id}))


def _unknown(object_id: ObjectKey) -> NotFoundError:
    return NotFoundError(f"no object {public_id(object_id)}", field="object_id")

"""Queries on API keys."""

from __future__ import annotations

from collections.abc import Mapping

from sqlalchemy import Connection, func, insert, or_, select, update

from service.errors import NotFoundError, QuotaExceededError
from service.store.base import KeyRecord
from service.store.signals import Signal, alone, send
from service.store.tables import api_keys


def add(connection: Connection, record: KeyRecord, quota: int = 0) -> None:
    """Store a new key. Raises ``QuotaExceededError`` where its tenant has ``quota`` (0: any number)."""
    alone(connection)
    query = select(func.count()).where(api_keys.c.tenant == record.tenant, api_keys.c.revoked_at.is_(None))
    if quota and connection.execute(query).scalar_one() >= quota:
        raise QuotaExceededError(f"{quota} keys are there", limit=quota, setting="SKYPOSE_QUOTA_KEYS")
    values = {name: getattr(record, name) for name in api_keys.columns.keys() if name != "number"}  # noqa: SIM118
    connection.execute(insert(api_keys).values(values))


def find(connection: Connection, key_id: str) -> KeyRecord | None:
    """The key of any tenant, or None: the one query that cannot know the tenant, as its answer says it."""
    row = connection.execute(select(api_keys).where(api_keys.c.id == key_id)).first()
    return None if row is None else KeyRecord(**row._mapping)


def page(connection: Connection, tenant: str | None, after: int, limit: int) -> list[KeyRecord]:
    """A tenant's keys in order of creation, from number ``after`` on; of all tenants (the command line) with None."""
    query = select(api_keys).where(api_keys.c.number > after).order_by(api_keys.c.number).limit(limit)
    if tenant is not None:
        query = query.where(api_keys.c.tenant == tenant)
    return [KeyRecord(**row._mapping) for row in connection.execute(query)]


def revoke(connection: Connection, tenant: str | None, key_id: str, now: str) -> KeyRecord:
    """End a tenant's key (None: of any), if it was not ended before. Raises ``NotFoundError``."""
    record = find(connection, key_id)
    if record is None or tenant not in (None, record.tenant):
        raise NotFoundError(f"no key {key_id}", field="key_id")
    query = update(api_keys).where(api_keys.c.id == key_id, api_keys.c.revoked_at.is_(None))
    connection.execute(query.values(revoked_at=now))
    send(connection, Signal("revoked", key_id))
    return record


def touch(connection: Connection, used: Mapping[str, str]) -> None:
    """Note when keys were last used."""
    for key_id, at in used.items():
        connection.execute(update(api_keys).where(api_keys.c.id == key_id).values(last_used_at=at))


def count_active(connection: Connection, now: str) -> int:
    """How many keys would be taken at this time."""
    lasting = or_(api_keys.c.expires_at.is_(None), api_keys.c.expires_at > now)
    query = select(func.count()).where(api_keys.c.revoked_at.is_(None), lasting)
    return int(connection.execute(query).scalar_one())

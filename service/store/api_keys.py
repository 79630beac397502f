"""Queries on API keys."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from sqlalchemy import Connection, func, insert, or_, select, update

from service.errors import DamagedError, NotFoundError, QuotaExceededError
from service.store.base import KeyRecord, Page
from service.store.pages import numbered_page
from service.store.seal import checked, record_values, row_of, sealed
from service.store.signals import Signal, alone, send
from service.store.tables import api_keys


def add(connection: Connection, record: KeyRecord, quota: int = 0) -> None:
    """Store a new key. Raises ``QuotaExceededError`` where its tenant has ``quota`` (0: any number)."""
    alone(connection)
    query = select(func.count()).where(api_keys.c.tenant == record.tenant, api_keys.c.revoked_at.is_(None))
    if quota and connection.execute(query).scalar_one() >= quota:
        raise QuotaExceededError(f"{quota} keys are there", limit=quota, setting="SKYPOSE_QUOTA_KEYS")
    connection.execute(insert(api_keys).values(sealed(api_keys, row_of(api_keys, record))))


def find_all(connection: Connection, key_ids: Sequence[str]) -> dict[str, KeyRecord | DamagedError]:
    """Those that there are, of any tenant, by id; why not where one is not as it was stored.

    The one query that cannot know the tenant, as its answer says it.
    """
    found: dict[str, KeyRecord | DamagedError] = {}
    for row in connection.execute(select(api_keys).where(api_keys.c.id.in_(key_ids))):
        try:
            found[row.id] = KeyRecord(**record_values(checked(api_keys, row)))
        except DamagedError as error:
            found[row.id] = error
    return found


def page(connection: Connection, tenant: str | None, after: int, limit: int) -> Page[KeyRecord]:
    """A tenant's keys in order of creation, from number ``after`` on; of all tenants (the command line) with None."""
    of = [] if tenant is None else [api_keys.c.tenant == tenant]
    return numbered_page(connection, api_keys, "id", KeyRecord, of, after, limit)


def revoke(connection: Connection, tenant: str | None, key_id: str, now: str) -> str:
    """End a tenant's key (None: of any), if it was not ended before; a damaged one too. Returns its tenant.

    Raises ``NotFoundError``.
    """
    found = connection.execute(select(api_keys.c.tenant).where(api_keys.c.id == key_id)).scalar()
    if found is None or tenant not in (None, found):
        raise NotFoundError(f"no key {key_id}", field="key_id")
    query = update(api_keys).where(api_keys.c.id == key_id, api_keys.c.revoked_at.is_(None))
    connection.execute(query.values(revoked_at=now))
    send(connection, Signal("revoked", key_id))
    return str(found)


def touch(connection: Connection, used: Mapping[str, str]) -> None:
    """Note when keys were last used."""
    for key_id, at in used.items():
        connection.execute(update(api_keys).where(api_keys.c.id == key_id).values(last_used_at=at))


def count_active(connection: Connection, now: str) -> int:
    """How many keys would be taken at this time."""
    lasting = or_(api_keys.c.expires_at.is_(None), api_keys.c.expires_at > now)
    query = select(func.count()).where(api_keys.c.revoked_at.is_(None), lasting)
    return int(connection.execute(query).scalar_one())

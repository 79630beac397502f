"""Queries on the audit log."""

from __future__ import annotations

from collections.abc import Sequence

from sqlalchemy import Connection, delete, func, insert, select

from service.store.base import AuditRecord
from service.store.tables import audit


def append(connection: Connection, records: Sequence[AuditRecord]) -> None:
    """Store entries, in order."""
    names = [name for name in audit.columns.keys() if name != "number"]  # noqa: SIM118
    connection.execute(insert(audit), [{name: getattr(record, name) for name in names} for record in records])


def page(connection: Connection, tenant: str, after: int, limit: int) -> list[AuditRecord]:
    """A tenant's entries in order, from number ``after`` on."""
    query = select(audit).where(audit.c.tenant == tenant, audit.c.number > after).order_by(audit.c.number)
    return [AuditRecord(**row._mapping) for row in connection.execute(query.limit(limit))]


def forget(connection: Connection, before: str, most: int) -> int:
    """Drop what is older than ``before``, and the oldest beyond ``most`` entries. Returns how many."""
    newest = connection.execute(select(func.max(audit.c.number))).scalar() or 0
    dropped = connection.execute(delete(audit).where((audit.c.at < before) | (audit.c.number <= newest - most)))
    return int(dropped.rowcount)

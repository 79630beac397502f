"""Queries on the audit log."""

from __future__ import annotations

from collections.abc import Sequence

from sqlalchemy import Connection, delete, func, insert, select

from service.store.base import AuditRecord, Page
from service.store.pages import numbered_page
from service.store.seal import row_of, sealed
from service.store.tables import audit


def append(connection: Connection, records: Sequence[AuditRecord]) -> None:
    """Store entries, in order."""
    connection.execute(insert(audit), [sealed(audit, row_of(audit, record)) for record in records])


def page(connection: Connection, tenant: str, after: int, limit: int) -> Page[AuditRecord]:
    """A tenant's entries in order, from number ``after`` on."""
    return numbered_page(connection, audit, "number", AuditRecord, [audit.c.tenant == tenant], after, limit)


def forget(connection: Connection, before: str, most: int) -> int:
    """Drop what is older than ``before``, and the oldest beyond ``most`` entries. Returns how many."""
    newest = connection.execute(select(func.max(audit.c.number))).scalar() or 0
    dropped = connection.execute(delete(audit).where((audit.c.at < before) | (audit.c.number <= newest - most)))
    return int(dropped.rowcount)

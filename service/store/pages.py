"""Pages of rows in order of creation."""

from __future__ import annotations

from collections.abc import Callable
from json import JSONDecodeError
from typing import Any

from sqlalchemy import Connection, Table, select

from service.errors import DamagedError
from service.store.base import Page, Record
from service.store.scope import public_id


def page_of(
    connection: Connection, table: Table, get: Callable[[Connection, Any], Record], tenant: str, after: int, limit: int
) -> Page[Record]:
    """A tenant's rows of ``table`` from number ``after`` on, each read by ``get``.

    Row by row: a damaged one, which ``get`` refuses, does not hide the others.
    """
    query = select(table.c.id, table.c.number).where(table.c.tenant == tenant, table.c.number > after)
    rows = connection.execute(query.order_by(table.c.number).limit(limit + 1)).all()
    records, damaged = [], []
    for row in rows[:limit]:
        try:
            records.append(get(connection, row.id))
        except (DamagedError, JSONDecodeError):
            damaged.append(public_id(row.id))
    return Page(tuple(records), tuple(damaged), rows[limit - 1].number if len(rows) > limit else None)

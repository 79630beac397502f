"""Pages of rows in order of creation."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from json import JSONDecodeError
from typing import Any

from sqlalchemy import ColumnElement, Connection, Table, select

from service.errors import DamagedError
from service.store.base import Page, Record
from service.store.scope import public_id
from service.store.seal import checked, record_values

Query = Sequence[ColumnElement[bool]]  # all of which a row must meet


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


def numbered_page(
    connection: Connection, table: Table, name: str, record: Callable[..., Record], of: Query, after: int, limit: int
) -> Page[Record]:
    """Rows of ``table`` from number ``after`` on that meet ``of``, each made a ``record``.

    Row by row, too; damaged ones are told by their column ``name``.
    """
    query = select(table.c.number, table.c[name]).where(table.c.number > after, *of)
    rows = connection.execute(query.order_by(table.c.number).limit(limit + 1)).all()
    records, damaged = [], []
    for row in rows[:limit]:
        try:
            whole = connection.execute(select(table).where(table.c.number == row.number)).one()
            records.append(record(**record_values(checked(table, whole))))
        except (DamagedError, JSONDecodeError):
            damaged.append(str(row._mapping[table.c[name]]))
    return Page(tuple(records), tuple(damaged), rows[limit - 1].number if len(rows) > limit else None)

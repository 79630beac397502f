"""Checksums of rows: what was stored is what is read.

A row's checksum is over its table, its key and all that does not change in it (``tables.CHANGES``): a row in another's
place is noticed too. It guards against disks, memory and stray hands, not against who can write the database. Rows of
releases before there were checksums have none, and are believed.
"""

from __future__ import annotations

import functools
import json
from collections.abc import Mapping
from hashlib import blake2b
from typing import Any

from sqlalchemy import Float, Row, Table
from sqlalchemy.sql.elements import KeyedColumnElement

from service.errors import DamagedError

CHECKSUM = "checksum"
_BYTES = 8  # one damaged row in 2**64 goes unnoticed
_KEYS = ("key", "object_id", "session_id", "id", "idx", "ordinal", "seq")


def is_sealed(table: Table) -> bool:
    """Whether rows of this table have a checksum."""
    return CHECKSUM in table.c


def sealed(table: Table, values: Mapping[str, Any]) -> dict[str, Any]:
    """A row to store, by column name, with its checksum."""
    return {**values, CHECKSUM: _checksum(table, {column: values[column.name] for column in _columns(table)})}


def row_of(table: Table, record: object) -> dict[str, Any]:
    """The row of a record with the same names, without what the database numbers; for ``sealed``."""
    return {name: getattr(record, name) for name in map(str, table.c.keys()) if name not in ("number", CHECKSUM)}


def record_values(row: Row[Any]) -> dict[str, Any]:
    """A row of one table as the values of its record."""
    return {str(name): value for name, value in row._mapping.items() if name != CHECKSUM}


def checked(table: Table, row: Row[Any]) -> Row[Any]:
    """The row, with all columns of this table in it. Raises ``DamagedError`` unless it is as it was stored."""
    if intact(table, row._mapping) is False:
        raise DamagedError(f"{row_name(table, row._mapping)} is not as it was stored")
    return row


def intact(table: Table, values: Mapping[Any, Any]) -> bool | None:
    """Whether a row, by column, is as it was stored; None of one that has no checksum."""
    stored = values[table.c.checksum]
    return None if stored is None else bool(stored == _checksum(table, values))


def row_name(table: Table, values: Mapping[Any, Any]) -> str:
    """Which row, by column, it is: for people."""
    keys = ", ".join(f"{name} {values[table.c[name]]}" for name in _KEYS if name in table.c)
    return f"{table.name} ({keys})"


@functools.cache
def _columns(table: Table) -> list[KeyedColumnElement[Any]]:
    return [column for column in table.c if column.name != CHECKSUM and not column.info.get("changes")]


def _checksum(table: Table, values: Mapping[Any, Any]) -> str:
    digest = blake2b(table.name.encode(), digest_size=_BYTES)
    for column in _columns(table):
        value = values[column]
        if not isinstance(value, bytes):
            number = isinstance(value, int) and isinstance(column.type, Float)
            value = json.dumps(float(value) if number else value, sort_keys=True).encode()
        digest.update(b"%d:" % len(value))
        digest.update(value)
    return digest.hexdigest()

"""A write that changes nothing: whether the database takes writes."""

from __future__ import annotations

from sqlalchemy import Connection, text


def write(connection: Connection) -> None:
    """Count one up in a row of its own."""
    upsert = "INSERT INTO probes (id, count) VALUES (1, 1) ON CONFLICT (id) DO UPDATE SET count = probes.count + 1"
    connection.execute(text(upsert))


def read(connection: Connection) -> None:
    """The least that can be read."""
    connection.execute(text("SELECT 1"))

"""Queries on the tickets that several processes share."""

from __future__ import annotations

from sqlalchemy import Connection, delete, func, insert, select

from service.errors import BusyError
from service.store.base import TicketRecord
from service.store.instances import clock
from service.store.tables import tickets


def add(connection: Connection, record: TicketRecord, lifetime_s: float, most: int) -> None:
    """Store a ticket, and drop those whose time is over. Raises ``BusyError`` where ``most`` wait to be used."""
    connection.execute(delete(tickets).where(tickets.c.until <= clock()))
    if connection.execute(select(func.count()).select_from(tickets)).scalar_one() >= most:
        raise BusyError("too many tickets wait to be used", limit=most, setting="SKYPOSE_TICKET_S")
    values = {name: getattr(record, name) for name in ("digest", "tenant", "key_id", "expires")}
    connection.execute(insert(tickets).values(**values, until=clock() + lifetime_s))


def take(connection: Connection, digest: str) -> TicketRecord | None:
    """Use a ticket up; None where it is not there, or too old."""
    columns = (tickets.c.digest, tickets.c.tenant, tickets.c.key_id, tickets.c.expires)
    in_time = (tickets.c.until > clock()).label("in_time")
    row = connection.execute(delete(tickets).where(tickets.c.digest == digest).returning(*columns, in_time)).first()
    if row is None or not row.in_time:
        return None
    return TicketRecord(row.digest, row.tenant, row.key_id, row.expires)

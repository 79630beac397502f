"""Queries on the processes of one PostgreSQL database: their leases, which sessions they have, what they share.

A session's owner is named in ``owners``; it counts while the lease of its process lasts, by the database's clock. So
one row is renewed per process, not one per session. Leases only say whom to ask: what is written is guarded by the
epoch.
"""

from __future__ import annotations

import secrets
from dataclasses import dataclass
from typing import TYPE_CHECKING

from sqlalchemy import ColumnElement, Connection, Float, Table, cast, delete, extract, func, insert, select, update

from service.store.scope import SessionKey
from service.store.tables import cluster, instances, owners, sessions

if TYPE_CHECKING:
    from sqlalchemy.dialects.postgresql import Insert

FORGOTTEN_S = 3600.0


@dataclass(frozen=True)
class Instance:
    """A process: its name, and how the others reach it."""

    id: str
    url: str


def clock() -> ColumnElement[float]:
    """Seconds since 1970 by the database's clock."""
    return cast(extract("epoch", func.clock_timestamp()), Float)


def register(connection: Connection, me: Instance, lease_s: float) -> float:
    """Begin a lease; what time it is. Whoever had this address before is gone, and its sessions are free at once."""
    old = (instances.c.url == me.url) | (instances.c.lease_until < clock() - FORGOTTEN_S)
    connection.execute(delete(instances).where(old, instances.c.id != me.id))
    connection.execute(delete(owners).where(owners.c.instance.not_in(select(instances.c.id))))
    return beat(connection, me, lease_s)


def beat(connection: Connection, me: Instance, lease_s: float) -> float:
    """Go on with the lease; what time it is by the database's clock."""
    until = clock() + lease_s
    query = update(instances).where(instances.c.id == me.id).values(lease_until=until)
    if connection.execute(query).rowcount == 0:
        connection.execute(insert(instances).values(id=me.id, url=me.url, lease_until=until))
    return float(connection.execute(select(clock())).scalar_one())


def leave(connection: Connection, me: Instance) -> None:
    """End the lease."""
    connection.execute(delete(instances).where(instances.c.id == me.id))
    connection.execute(delete(owners).where(owners.c.instance == me.id))


def live(connection: Connection) -> list[Instance]:
    """The processes whose lease lasts, the one with the fewest sessions first."""
    count = func.count(owners.c.session_id)
    query = (
        select(instances.c.id, instances.c.url)
        .join(owners, owners.c.instance == instances.c.id, isouter=True)
        .where(instances.c.lease_until > clock())
        .group_by(instances.c.id, instances.c.url)
        .order_by(count, instances.c.id)
    )
    return [Instance(row.id, row.url) for row in connection.execute(query)]


def owner(connection: Connection, session_id: SessionKey) -> Instance | None:
    """Who has the session, if its lease lasts."""
    query = (
        select(instances.c.id, instances.c.url)
        .join(owners, owners.c.instance == instances.c.id)
        .where(owners.c.session_id == session_id, instances.c.lease_until > clock())
    )
    row = connection.execute(query).first()
    return None if row is None else Instance(row.id, row.url)


def assign(connection: Connection, session_id: SessionKey, instance: str) -> None:
    """Make a process the session's owner. The caller holds the session's row."""
    values = {"session_id": session_id, "instance": instance}
    query = _insert(owners).values(values)
    connection.execute(query.on_conflict_do_update(index_elements=["session_id"], set_={"instance": instance}))


def release(connection: Connection, session_id: SessionKey, epoch: int, me: str, to: str | None = None) -> bool:
    """Give the session up, to nobody or to another; ``epoch`` is the one it was held under.

    Returns whether it was still held. With ``to`` the epoch rises: nothing of the former owner can be written.
    """
    query = select(sessions.c.epoch).where(sessions.c.id == session_id).with_for_update()
    held = connection.execute(query).scalar() == epoch
    mine = (owners.c.session_id == session_id) & (owners.c.instance == me)
    if held and to is None:
        connection.execute(delete(owners).where(mine))
    elif held and to is not None:
        connection.execute(update(sessions).where(sessions.c.id == session_id).values(epoch=epoch + 1))
        assign(connection, session_id, to)
    return held


def secret(connection: Connection) -> str:
    """What all processes of this database know, and nobody else."""
    fresh = _insert(cluster).values(id=1, secret=secrets.token_urlsafe(32))
    connection.execute(fresh.on_conflict_do_nothing())
    found: str = connection.execute(select(cluster.c.secret)).scalar_one()
    return found


def _insert(table: Table) -> Insert:
    from sqlalchemy.dialects import postgresql  # a dialect that most services never need

    return postgresql.insert(table)

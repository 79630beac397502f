"""How much of the database is a tenant's."""

from __future__ import annotations

from sqlalchemy import Connection, func, select, union

from service.store.tables import beliefs, blobs, contenders, estimates, frame_bodies, models, particles, sessions

_OF_SESSIONS = (
    frame_bodies.c.body,
    estimates.c.document,
    particles.c.state,
    beliefs.c.belief,
    contenders.c.state,
)


def stored_bytes(connection: Connection, tenant: str) -> int:
    """Bytes of a tenant's files, estimates and particles; a file that two tenants hold counts for each.

    The database knows lengths without reading what is that long; still this looks at every row.
    """
    own = select(sessions.c.id).where(sessions.c.tenant == tenant)
    total = 0
    for column in _OF_SESSIONS:
        query = select(func.coalesce(func.sum(func.length(column)), 0)).where(column.table.c.session_id.in_(own))
        total += int(connection.execute(query).scalar_one())
    keys = union(
        select(models.c.blob_key).where(models.c.tenant == tenant),
        select(sessions.c.background_key).where(sessions.c.tenant == tenant),
    )
    query = select(func.coalesce(func.sum(func.length(blobs.c.data)), 0)).where(blobs.c.key.in_(keys))
    return total + int(connection.execute(query).scalar_one())

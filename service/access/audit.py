"""The audit log: who did what, when, and how it ended. No secrets, no pixels, no bodies.

Entries are gathered and stored once a second, off every call's way; the same refusal over and over is one entry with
a count, so that nobody can wash the log out.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from dataclasses import dataclass, replace
from datetime import UTC, datetime, timedelta

from service.access.keys import utc_text
from service.store import audit
from service.store.base import AuditRecord, Page
from service.store.database import Database

REFUSED = 400
GATHER_REFUSALS_S = 60
MOST_WAITING = 5_000
FORGET_EVERY_S = 3600
MOST_TARGET = 200


@dataclass(frozen=True)
class Entry:
    """One call. ``action`` is method and route, ``target`` what the route's path names."""

    tenant: str
    actor: str
    address: str
    action: str
    target: str
    outcome: int
    request_id: str


class Audit:
    """Gathers entries, stores them, forgets the old."""

    def __init__(
        self,
        database: Database,
        days: int,
        most: int,
        clock: Callable[[], datetime] = lambda: datetime.now(UTC),
    ) -> None:
        self._database = database
        self._days = days
        self._most = most
        self._clock = clock
        self._done: list[AuditRecord] = []
        self._storing = asyncio.Lock()
        self._refused: dict[tuple[str, str, str, str, int], AuditRecord] = {}
        self._gathered_since = self._forgotten_at = datetime.min.replace(tzinfo=UTC)

    def note(self, entry: Entry) -> None:
        """Take an entry."""
        at = utc_text(self._clock())
        record = AuditRecord(
            at=at,
            tenant=entry.tenant,
            actor=entry.actor,
            address=entry.address,
            action=entry.action,
            target=entry.target[:MOST_TARGET],
            outcome=entry.outcome,
            request_id=entry.request_id[:MOST_TARGET],
        )
        if entry.outcome < REFUSED and len(self._done) < MOST_WAITING:
            self._done.append(record)
        else:
            self._gather(record)

    async def store(self, *, final: bool = False) -> None:
        """Write what was gathered; refusals once a minute, or when it is the ``final`` time.

        Raises ``StorageError``; what was not written stays for the next time.
        """
        async with self._storing:  # or what one is writing another would write too
            await self._store(final)

    async def _store(self, final: bool) -> None:
        now = self._clock()
        records, refused = list(self._done), {}
        if final or now - self._gathered_since >= timedelta(seconds=GATHER_REFUSALS_S):
            refused, self._refused, self._gathered_since = self._refused, {}, now
        if records or refused:
            await self._database.write(audit.append, [*records, *refused.values()])
            del self._done[: len(records)]
        if now - self._forgotten_at >= timedelta(seconds=FORGET_EVERY_S):
            self._forgotten_at = now
            await self._database.write(audit.forget, utc_text(now - timedelta(days=self._days)), self._most)

    async def page(self, tenant: str, after: int, limit: int) -> Page[AuditRecord]:
        """A tenant's entries after a cursor."""
        return await self._database.read(audit.page, tenant, after, limit)

    def _gather(self, record: AuditRecord) -> None:
        place = (record.tenant, record.actor, record.address, record.action, record.outcome)
        if place not in self._refused and len(self._refused) >= MOST_WAITING:
            record = replace(record, actor="(others)", address="(others)", action="(others)", target="")
            place = (record.tenant, record.actor, record.address, record.action, record.outcome)
        known = self._refused.get(place)
        self._refused[place] = record if known is None else replace(known, count=known.count + 1)

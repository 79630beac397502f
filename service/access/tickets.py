"""Tickets: what a browser shows instead of a key where it cannot set headers. Once, and soon."""

from __future__ import annotations

import hashlib
import secrets
import time
from abc import ABC, abstractmethod
from collections import OrderedDict
from dataclasses import replace
from datetime import datetime

from service.access.principal import Principal, Role
from service.errors import BusyError, UnauthorizedError
from service.store import tickets
from service.store.base import TicketRecord
from service.store.database import Database

MOST = 10_000


class Tickets(ABC):
    """Those that wait to be used."""

    def __init__(self, lifetime_s: float) -> None:
        self.lifetime_s = lifetime_s

    async def issue(self, principal: Principal) -> str:
        """A ticket for reading in the name of ``principal``. Raises ``BusyError`` where too many wait."""
        ticket = secrets.token_urlsafe(32)
        await self._put(_digest(ticket), replace(principal, role=Role.READ))
        return ticket

    async def redeem(self, ticket: str) -> Principal:
        """Whose it was; it is worth nothing afterwards. Raises ``UnauthorizedError``."""
        principal = await self._take(_digest(ticket))
        if principal is None:
            raise UnauthorizedError("the ticket is not known, was used, or has run out", field="query:ticket")
        return principal

    @abstractmethod
    async def _put(self, digest: str, principal: Principal) -> None:
        """Keep it until it is used or its time is over."""

    @abstractmethod
    async def _take(self, digest: str) -> Principal | None:
        """Use it up."""


class OwnTickets(Tickets):
    """Of one process: in memory, in the order of their end. They are worth nothing after a restart."""

    def __init__(self, lifetime_s: float) -> None:
        super().__init__(lifetime_s)
        self._waiting: OrderedDict[str, tuple[float, Principal]] = OrderedDict()

    async def _put(self, digest: str, principal: Principal) -> None:
        self._drop_old()
        if len(self._waiting) >= MOST:
            raise BusyError("too many tickets wait to be used", limit=MOST, setting="SKYPOSE_TICKET_S")
        self._waiting[digest] = (time.monotonic() + self.lifetime_s, principal)

    async def _take(self, digest: str) -> Principal | None:
        until, principal = self._waiting.pop(digest, (0.0, None))
        return principal if time.monotonic() < until else None

    def _drop_old(self) -> None:
        now = time.monotonic()
        while self._waiting and next(iter(self._waiting.values()))[0] <= now:
            self._waiting.popitem(last=False)


class SharedTickets(Tickets):
    """Of all processes on a database: one gives a ticket out, any other takes it, once."""

    def __init__(self, database: Database, lifetime_s: float) -> None:
        super().__init__(lifetime_s)
        self._database = database

    async def _put(self, digest: str, principal: Principal) -> None:
        expires = None if principal.expires is None else principal.expires.isoformat()
        record = TicketRecord(digest, principal.tenant, principal.key_id, expires)
        await self._database.write(tickets.add, record, self.lifetime_s, MOST)

    async def _take(self, digest: str) -> Principal | None:
        record = await self._database.write(tickets.take, digest)
        if record is None:
            return None
        expires = None if record.expires is None else datetime.fromisoformat(record.expires)
        return Principal(record.tenant, record.key_id, Role.READ, expires)


def _digest(ticket: str) -> str:
    return hashlib.sha256(ticket.encode()).hexdigest()

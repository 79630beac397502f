"""Tickets: what a browser shows instead of a key where it cannot set headers. Once, and soon."""

from __future__ import annotations

import hashlib
import secrets
import time
from collections import OrderedDict
from dataclasses import replace

from service.access.principal import Principal, Role
from service.errors import BusyError, UnauthorizedError

MOST = 10_000


class Tickets:
    """Those that wait to be used, in the order of their end. Kept in memory: they are worth nothing after a restart."""

    def __init__(self, lifetime_s: float) -> None:
        self.lifetime_s = lifetime_s
        self._waiting: OrderedDict[bytes, tuple[float, Principal]] = OrderedDict()

    def issue(self, principal: Principal) -> str:
        """A ticket for reading in the name of ``principal``. Raises ``BusyError`` where too many wait."""
        self._drop_old()
        if len(self._waiting) >= MOST:
            raise BusyError("too many tickets wait to be used", limit=MOST, setting="SKYPOSE_TICKET_S")
        ticket = secrets.token_urlsafe(32)
        self._waiting[_digest(ticket)] = (time.monotonic() + self.lifetime_s, replace(principal, role=Role.READ))
        return ticket

    def redeem(self, ticket: str) -> Principal:
        """Whose it was; it is worth nothing afterwards. Raises ``UnauthorizedError``."""
        until, principal = self._waiting.pop(_digest(ticket), (0.0, None))
        if principal is None or time.monotonic() >= until:
            raise UnauthorizedError("the ticket is not known, was used, or has run out", field="query:ticket")
        return principal

    def _drop_old(self) -> None:
        now = time.monotonic()
        while self._waiting and next(iter(self._waiting.values()))[0] <= now:
            self._waiting.popitem(last=False)


def _digest(ticket: str) -> bytes:
    return hashlib.sha256(ticket.encode()).digest()

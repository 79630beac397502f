"""How much a tenant may keep: measured now and then, and what came since is added to it."""

from __future__ import annotations

import asyncio
import time
from collections import OrderedDict
from collections.abc import Callable
from dataclasses import dataclass

from service.errors import QuotaExceededError
from service.settings import MEBIBYTE
from service.store import usage
from service.store.database import Database

FRESH_S = 10.0
SHARE = 20  # a measurement is good for so many times as long as it took, so that it never is the main work
MOST_TENANTS = 10_000


@dataclass
class _Known:
    size: int
    until: float


class StoredBytes:
    """The quota of stored bytes. Bodies count as they come, which is about what is then stored of them."""

    def __init__(self, database: Database, quota_mb: int, clock: Callable[[], float] = time.monotonic) -> None:
        self._database = database
        self._quota_mb = quota_mb  # 0: any
        self._clock = clock
        self._known: OrderedDict[str, _Known] = OrderedDict()
        self._measuring = asyncio.Lock()

    async def require_room(self, tenant: str) -> None:
        """Raises ``QuotaExceededError`` where a tenant has as much as it may have."""
        if self._quota_mb and await self._size(tenant) >= self._quota_mb * MEBIBYTE:
            raise QuotaExceededError(
                f"{self._quota_mb} MiB are stored", limit=self._quota_mb, setting="SKYPOSE_QUOTA_STORED_MB"
            )

    def grew(self, tenant: str, size: int) -> None:
        """So much more came in."""
        known = self._known.get(tenant)
        if known is not None:
            known.size += size

    def forget(self, tenant: str) -> None:
        """Something was deleted: measure anew when it is asked for."""
        self._known.pop(tenant, None)

    async def _size(self, tenant: str) -> int:
        if self._fresh(tenant) is None:
            async with self._measuring:
                if self._fresh(tenant) is None:  # whoever waited here finds what the first one measured
                    await self._measure(tenant)
        known = self._known.get(tenant)
        return 0 if known is None else known.size  # None: just deleted from

    def _fresh(self, tenant: str) -> _Known | None:
        known = self._known.get(tenant)
        return known if known is not None and self._clock() < known.until else None

    async def _measure(self, tenant: str) -> None:
        began = self._clock()
        size = await self._database.read(usage.stored_bytes, tenant)
        now = self._clock()
        self._known[tenant] = _Known(size, now + max(FRESH_S, SHARE * (now - began)))
        self._known.move_to_end(tenant)
        if len(self._known) > MOST_TENANTS:
            self._known.popitem(last=False)

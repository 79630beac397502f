"""How much the service takes on at once, in bytes and in calls. Past that it refuses before memory grows."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager

from service.errors import BusyError, RateLimitedError


class Hold:
    """The share of one request. ``tenant``: whose it is, where that is known; else it has no quota."""

    def __init__(self, admission: Admission) -> None:
        self._admission = admission
        self.tenant = ""
        self.size = 0

    def grow(self, size: int) -> None:
        """Hold so many bytes more. Raises as ``Admission.require_room``."""
        self._admission.require_room(self.tenant, size)
        self._admission.add(self.tenant, size)
        self.size += size


class Admission:
    """Counts the bytes held, and those of each tenant. ``quota`` of one tenant, 0: any."""

    def __init__(self, limit: int, quota: int = 0) -> None:
        self._limit = limit
        self._quota = quota
        self._of: Counter[str] = Counter()
        self.size = 0

    @contextmanager
    def hold(self) -> Iterator[Hold]:
        """Hold bytes until the block ends."""
        hold = Hold(self)
        try:
            yield hold
        finally:
            self.add(hold.tenant, -hold.size)

    def require_room(self, tenant: str, size: int) -> None:
        """Raises ``RateLimitedError`` past the tenant's quota, ``BusyError`` past the limit of all."""
        detail = "too many bytes of requests are waiting"
        if tenant and 0 < self._quota < self._of[tenant] + size:
            raise RateLimitedError(detail, setting="SKYPOSE_QUOTA_PENDING_MB", limit=self._quota)
        if self.size + size > self._limit:
            raise BusyError(detail, setting="SKYPOSE_MAX_PENDING_MB", limit=self._limit)

    def add(self, tenant: str, size: int) -> None:
        """Count bytes, or bytes less, without asking."""
        self.size += size
        self._of[tenant] += size
        if not self._of[tenant]:
            del self._of[tenant]


class Places:
    """So many at once, each held until its block ends."""

    def __init__(self, most: int, setting: str) -> None:
        self._most = most
        self._setting = setting
        self._taken = 0

    @contextmanager
    def take(self) -> Iterator[None]:
        """Hold a place. Raises ``BusyError`` where there is none."""
        if self._taken >= self._most:
            raise BusyError("too many calls of this kind are under way", limit=self._most, setting=self._setting)
        self._taken += 1
        try:
            yield
        finally:
            self._taken -= 1

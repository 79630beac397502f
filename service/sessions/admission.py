"""How much the service takes on at once, in bytes and in calls. Past that it refuses before memory grows."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from service.errors import BusyError


class Hold:
    """The share of one request."""

    def __init__(self, admission: Admission) -> None:
        self._admission = admission
        self.size = 0

    def grow(self, size: int) -> None:
        """Hold so many bytes more. Raises ``BusyError`` where they do not fit."""
        if self._admission.size + size > self._admission.limit:
            raise BusyError(
                "too many bytes of requests are waiting",
                setting="SKYPOSE_MAX_PENDING_MB",
                limit=self._admission.limit,
            )
        self._admission.size += size
        self.size += size


class Admission:
    """Counts the bytes held."""

    def __init__(self, limit: int) -> None:
        self.limit = limit
        self.size = 0

    @contextmanager
    def hold(self, size: int = 0) -> Iterator[Hold]:
        """Hold bytes until the block ends."""
        hold = Hold(self)
        hold.grow(size)
        try:
            yield hold
        finally:
            self.size -= hold.size


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

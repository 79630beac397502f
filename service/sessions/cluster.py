"""This process among those that share its PostgreSQL database: its lease, and what it hears from the others."""

from __future__ import annotations

import asyncio
import contextlib
import time
from collections.abc import Callable

import structlog

from service.errors import StorageError
from service.store import instances
from service.store.instances import Instance
from service.store.postgres import PostgresDatabase
from service.store.signals import Heard, Signal

__all__ = ["Cluster", "Instance"]
log = structlog.get_logger(__name__)
BEATS = 3  # in one lease: one may be late
_PROMPT_S = 5.0  # an answer that took longer says little about what time it is


class Cluster:
    """``me`` and the others. ``heard`` and ``resumed`` are called in the event loop (``PostgresDatabase.listen``)."""

    def __init__(
        self, database: PostgresDatabase, me: Instance, lease_s: float, heard: Heard, resumed: Callable[[], None]
    ) -> None:
        self.me = me
        self.lease_s = lease_s
        self._database = database
        self._heard = heard
        self._resumed = resumed
        self._beating: asyncio.Task[None] | None = None
        self._ahead_s: float | None = None  # of the database's clock before this machine's monotonic one

    def now(self) -> float:
        """Seconds since 1970 by the database's clock, however this machine's own is set."""
        return time.monotonic() + (self._ahead_s or 0.0)

    async def start(self) -> None:
        """Begin the lease, and listen. The database is open."""
        loop = asyncio.get_running_loop()

        def heard(signal: Signal) -> None:
            _from_thread(loop, lambda: self._heard(signal))

        begun = time.monotonic()
        self._set(begun, await self._database.write(instances.register, self.me, self.lease_s))
        self._database.listen(heard, lambda: _from_thread(loop, self._resumed))
        self._beating = asyncio.create_task(self._beat())
        log.info("one of several processes", instance=self.me.id, url=self.me.url)

    async def live(self) -> list[Instance]:
        """The processes whose lease lasts, the least busy first."""
        return await self._database.read(instances.live)

    async def stop(self) -> None:
        """End the lease: the others may take the sessions at once."""
        if self._beating is not None:
            self._beating.cancel()
            with contextlib.suppress(asyncio.CancelledError):
                await self._beating
        try:
            await self._database.write(instances.leave, self.me)
        except StorageError as error:
            log.warning("lease not ended; it runs out by itself", error=error.detail)

    async def _beat(self) -> None:
        while True:
            await asyncio.sleep(self.lease_s / BEATS)
            try:
                begun = time.monotonic()
                self._set(begun, await self._database.write(instances.beat, self.me, self.lease_s))
            except StorageError as error:
                log.warning("lease not renewed; tried again", error=error.detail)

    def _set(self, begun: float, now: float) -> None:
        """The database's clock, as it was read since ``begun``."""
        answered = time.monotonic()
        if self._ahead_s is None or answered - begun < _PROMPT_S:
            self._ahead_s = now - (begun + answered) / 2


def _from_thread(loop: asyncio.AbstractEventLoop, call: Callable[[], None]) -> None:
    with contextlib.suppress(RuntimeError):  # the loop has ended: nobody is left to be told
        loop.call_soon_threadsafe(call)

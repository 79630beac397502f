"""How the service is: ready, and on what it runs."""

from __future__ import annotations

import asyncio
import math
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from service.errors import StorageError
from service.store import probe
from service.store.database import Database
from service.store.disk import Room
from service.workers.engine import Engine

WRITE_EVERY_S = 5.0  # probes may come many times a second; each write costs the disk a flush


@dataclass(frozen=True)
class Checks:
    """What must be true before frames can be taken, and a line for each thing that is not."""

    worker: bool
    database: bool
    reasons: tuple[str, ...]


class Status:
    """Asks the rooms. With less than ``min_free_bytes`` of disk the database is not ready."""

    def __init__(
        self, database: Database, engine: Engine, min_free_bytes: int = 0, clock: Callable[[], float] = time.monotonic
    ) -> None:
        self._database = database
        self._engine = engine
        self._min_free_bytes = min_free_bytes
        self._clock = clock
        self._writing = asyncio.Lock()
        self._written_at = -math.inf
        self._refusal: str | None = None  # of the newest write

    async def checks(self) -> Checks:
        """Ready, or why not. Reads each time, writes no more often than ``WRITE_EVERY_S``."""
        worker = self._engine.transport.ready
        reasons = [] if worker else ["no worker is ready"]
        try:
            await self._database.read(probe.read)
            async with self._writing:
                if self._clock() - self._written_at >= WRITE_EVERY_S:
                    self._refusal = await self._try_write()
                    self._written_at = self._clock()
            refusal = self._refusal
        except StorageError as error:
            refusal = error.detail
        return Checks(worker, refusal is None, (*reasons, *([refusal] if refusal else ())))

    async def _try_write(self) -> str | None:
        try:
            await self._database.write(probe.write)
            return too_full(await self._database.room(), self._min_free_bytes)
        except StorageError as error:
            return error.detail

    async def worker(self) -> Mapping[str, Any]:
        """Devices, scorer and versions, as a worker sees them."""
        return await self._engine.describe()

    def processes(self) -> list[dict[str, Any]]:
        """The worker processes."""
        return [dict(process) for process in self._engine.transport.processes()]


def too_full(room: Room, min_free_bytes: int) -> str | None:
    """What to say of a disk with too little left; None of one with enough, or one that is not this machine's."""
    if room.free is None or room.free >= min_free_bytes:
        return None
    free, wanted = room.free >> 20, min_free_bytes >> 20
    return f"the disk is full: {free} MiB are free, SKYPOSE_MIN_FREE_MB asks for {wanted}"

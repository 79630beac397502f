"""What the service does by itself, once a second: metrics, idle sessions, the audit log, what retention lets go."""

from __future__ import annotations

import asyncio
import math
import time

import structlog

from service.access.audit import Entry
from service.api.services import Services
from service.errors import StorageError
from service.store.database import Database
from service.store.scope import public_id, tenant_of
from service.workers.engine import Engine

log = structlog.get_logger(__name__)
EVERY_S = 1.0
MEASURE_EVERY_S = 10.0  # the database's size: PostgreSQL adds up all its files for it


class Housekeeping:
    """Runs until it is cancelled. What the database refuses is logged, and tried again."""

    def __init__(self, services: Services, engine: Engine, database: Database) -> None:
        self._services = services
        self._engine = engine
        self._database = database
        self._measured_at = -math.inf

    async def run(self) -> None:
        """Once a second, for ever."""
        while True:
            due = time.monotonic() + EVERY_S
            await asyncio.sleep(EVERY_S)
            self._services.metrics.loop_lag_seconds.set(time.monotonic() - due)
            self._count()
            await self._note_callers()
            await self._look_at_logs()
            await self._measure()
            if self._services.registry.waiting_frames == 0:
                await self._let_go()

    def _count(self) -> None:
        services, metrics = self._services, self._services.metrics
        metrics.evictions.inc(services.registry.evict())
        metrics.resident_sessions.set(len(services.registry.resident))
        metrics.waiting_frames.set(services.registry.waiting_frames)
        metrics.waiting_bytes.set(services.admission.size)
        metrics.watchers.set(services.hub.watchers)
        metrics.worker_restarts.set(self._engine.transport.restarts)

    async def _note_callers(self) -> None:
        try:
            await self._services.audit.store()
            await self._services.keys.note_use()
        except StorageError as error:
            log.warning("audit log or use of keys not stored; tried again", error=error.detail)

    async def _look_at_logs(self) -> None:
        """A process that dies after a commit tells nobody: this is how late its watchers elsewhere are at most."""
        try:
            if self._services.forwarding.cluster is not None:
                await self._services.hub.look_again()
        except StorageError as error:
            log.warning("logs of watched sessions not read; tried again", error=error.detail)

    async def _measure(self) -> None:
        if time.monotonic() - self._measured_at < MEASURE_EVERY_S:
            return
        self._measured_at = time.monotonic()
        try:
            room = await self._database.room()
        except StorageError as error:
            log.warning("database not measured; tried again", error=error.detail)
            return
        self._services.metrics.database_bytes.set(room.used)
        self._services.metrics.disk_free_bytes.set(math.nan if room.free is None else room.free)

    async def _let_go(self) -> None:
        try:
            done = await self._services.pruning.step()
        except StorageError as error:
            log.warning("a rule of retention not carried out; tried again", error=error.detail)
            return
        if done is not None:
            self._services.metrics.retention.labels(done.action).inc()
            tenant, target = tenant_of(done.session_id), public_id(done.session_id)
            self._services.audit.note(Entry(tenant, "skypose", "-", f"retention: {done.action}", target, 200, ""))
            log.info("session ended or deleted by rule", session_id=done.session_id, action=done.action)

"""What a process does when another on the same database says that something has changed."""

from __future__ import annotations

import asyncio
from dataclasses import dataclass, field

import structlog

from service.access.keys import Keys
from service.errors import StorageError
from service.sessions.hub import Hub
from service.sessions.registry import Registry
from service.store.scope import SessionKey
from service.store.signals import Signal

log = structlog.get_logger(__name__)


@dataclass(frozen=True)
class Ears:
    """The rooms that are told. Called in the event loop."""

    hub: Hub
    registry: Registry
    keys: Keys
    _looking: set[asyncio.Task[None]] = field(default_factory=set)

    def heard(self, signal: Signal) -> None:
        """Tell them."""
        session = SessionKey(signal.key)
        match signal.kind:
            case "grown":
                self.hub.grown(session, signal.number)
            case "replaced":
                self.registry.forget(session)
                self.hub.advance(session, signal.number)
            case "deleted":
                self.registry.forget(session)
                self.hub.end(session, "deleted")
            case "revoked":
                self.keys.forget(signal.key)

    def resumed(self) -> None:
        """Signals may have been missed: look at the rows."""
        self.keys.forget()
        task = asyncio.create_task(self._look())
        self._looking.add(task)
        task.add_done_callback(self._looking.discard)

    async def _look(self) -> None:
        try:
            await self.hub.look_again()
        except StorageError as error:  # then listening begins again too, and this with it
            log.warning("watchers not brought up to date", error=error.detail)

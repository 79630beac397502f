"""Sessions end and go by rule: what nobody sends frames to ends, and what has ended is deleted after a time."""

from __future__ import annotations

import math
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Literal

from service.errors import NotFoundError
from service.sessions.frame import format_time
from service.sessions.registry import Registry
from service.store import sessions
from service.store.base import SessionStamp
from service.store.database import Database
from service.store.rules import Rules
from service.store.scope import SessionKey

LOOK_EVERY_S = 3600.0


@dataclass(frozen=True)
class Done:
    """What a rule did with a session."""

    session_id: SessionKey
    action: Literal["end", "delete"]


class Pruning:
    """Does what the rules ask for, one session a step, so that nothing waits for long."""

    def __init__(
        self,
        database: Database,
        registry: Registry,
        rules: Rules,
        clock: Callable[[], datetime] = lambda: datetime.now(UTC),
    ) -> None:
        self._database = database
        self._registry = registry
        self._rules = rules
        self._clock = clock
        self._looked_at = -math.inf
        self._due: deque[SessionStamp] = deque()

    async def step(self) -> Done | None:
        """The next thing that is due, done; None where nothing is. Raises ``StorageError``: it is tried again later."""
        if self._rules == Rules():
            return None
        if not self._due and time.monotonic() - self._looked_at >= LOOK_EVERY_S:
            stamps = await self._database.read(sessions.stamps)
            self._looked_at = time.monotonic()
            self._due.extend(stamp for stamp in stamps if self._rules.due(stamp, self._clock()))
        while self._due:
            stamp = self._due.popleft()
            now = self._clock()
            action = self._rules.due(stamp, now)
            if action == "end" and await self._database.write(sessions.end, stamp, format_time(now)):
                return Done(stamp.id, action)
            if action == "delete" and await self._delete(stamp):
                return Done(stamp.id, action)
        return None

    async def _delete(self, stamp: SessionStamp) -> bool:
        try:
            await self._registry.remove(stamp.id, stamp)
        except NotFoundError:  # another process was first, or it was put back and goes on
            return False
        return True

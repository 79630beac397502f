"""Fan-out to watchers. A watcher is a cursor in the session's event log; the hub only says that it has grown.

Newest events are kept in a small ring per watched session; anything older is read from the database. So a
slow watcher costs no memory, and one that resumes loses and repeats nothing.
"""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import AsyncGenerator
from contextlib import aclosing, asynccontextmanager
from dataclasses import dataclass, field
from typing import Literal

from service.errors import BusyError, QuotaExceededError
from service.store import frames
from service.store.base import StoredEvent
from service.store.database import Database
from service.store.scope import SessionKey, tenant_of
from service.store.signals import Signal

PAGE = 100


@dataclass(frozen=True)
class Message:
    """What a watcher gets. ``seq`` is where it stands after it."""

    type: Literal["estimate", "heartbeat", "resync-required", "end"]
    seq: int
    document: bytes | None = None  # of an estimate
    reason: str | None = None  # of an end


@dataclass
class _Channel:
    ring: deque[StoredEvent]
    watchers: int = 0
    newest: int = 0
    ended: str | None = None
    changed: asyncio.Event = field(default_factory=asyncio.Event)

    def grow(self) -> None:
        """Wake every watcher."""
        self.changed.set()
        self.changed = asyncio.Event()

    def since(self, cursor: int) -> list[StoredEvent] | None:
        """Events after ``cursor``, or None where the ring does not reach back so far, or not to the newest."""
        if not self.ring or self.ring[0].seq > cursor + 1 or self.ring[-1].seq < self.newest:
            return None
        return [event for event in self.ring if event.seq > cursor]


class Hub:
    """The channels of all watched sessions."""

    def __init__(
        self,
        database: Database,
        *,
        ring: int,
        max_lag: int,
        heartbeat_s: float,
        max_watchers: int,
        quota: int = 0,
    ) -> None:
        self._database = database
        self._ring = ring
        self._max_lag = max_lag
        self._heartbeat_s = heartbeat_s
        self._max_watchers = max_watchers
        self._quota = quota  # of one tenant; 0: none
        self._channels: dict[SessionKey, _Channel] = {}
        self._stopping: str | None = None

    @property
    def watchers(self) -> int:
        """Watchers at present."""
        return sum(channel.watchers for channel in self._channels.values())

    def _watchers_of(self, tenant: str) -> int:
        return sum(channel.watchers for key, channel in self._channels.items() if tenant_of(key) == tenant)

    def publish(self, session_id: SessionKey, seq: int, document: bytes) -> None:
        """Tell the watchers of a committed event, here and at the other processes."""
        self._database.tell(Signal("grown", session_id, seq))
        channel = self._channels.get(session_id)
        if channel is not None:
            if channel.ring and channel.ring[-1].seq != seq - 1:  # another process wrote what is between
                channel.ring.clear()
            channel.ring.append(StoredEvent(seq, document))
            channel.newest = max(channel.newest, seq)  # another process, or the log, may have said more already
            channel.grow()

    def advance(self, session_id: SessionKey, newest: int) -> None:
        """Tell the watchers that the log has grown in the database."""
        channel = self._channels.get(session_id)
        if channel is not None:
            channel.ring.clear()
            channel.newest = newest
            channel.grow()

    def grown(self, session_id: SessionKey, newest: int) -> None:
        """The same, said by another process, maybe late."""
        channel = self._channels.get(session_id)
        if channel is not None and newest > channel.newest:
            self.advance(session_id, newest)

    async def look_again(self) -> None:
        """Read how far the log of every watched session is: signals of other processes may have been missed."""
        watched = list(self._channels)
        if not watched:
            return
        newest = await self._database.read(frames.last_seqs, watched)
        for session_id in watched:
            if session_id in newest:
                self.grown(session_id, newest[session_id])
            else:
                self.end(session_id, "deleted")

    def end(self, session_id: SessionKey, reason: str) -> None:
        """Send a session's watchers home."""
        channel = self._channels.get(session_id)
        if channel is not None:
            channel.ended = reason
            channel.grow()

    def stop(self) -> None:
        """Send all watchers home: the service is shutting down."""
        self._stopping = "shutdown"
        for session_id in list(self._channels):
            self.end(session_id, "shutdown")

    @asynccontextmanager
    async def watch(self, session_id: SessionKey, after: int | None) -> AsyncGenerator[AsyncGenerator[Message]]:
        """Events after number ``after`` (None: only new ones), then new ones as they come, in order.

        Raises ``NotFoundError`` for an unknown session, ``BusyError`` past the number of watchers,
        ``QuotaExceededError`` past the tenant's.
        """
        if self.watchers >= self._max_watchers:
            raise BusyError("too many streams", setting="SKYPOSE_MAX_STREAMS", limit=self._max_watchers)
        if self._quota and self._watchers_of(tenant_of(session_id)) >= self._quota:
            raise QuotaExceededError("too many streams", setting="SKYPOSE_QUOTA_STREAMS", limit=self._quota)
        channel = self._channels.setdefault(session_id, _Channel(deque(maxlen=self._ring)))
        channel.watchers += 1  # before the log is read: whatever is committed from now on wakes us
        try:
            newest = await self._database.read(frames.last_seq, session_id)
            channel.newest = max(channel.newest, newest)
            channel.ended = channel.ended or self._stopping
            cursor = newest if after is None else max(after, 0)
            async with aclosing(self._follow(session_id, channel, cursor)) as messages:
                yield messages
        finally:
            channel.watchers -= 1
            if channel.watchers == 0 and self._channels.get(session_id) is channel:
                del self._channels[session_id]

    async def _follow(self, session_id: SessionKey, channel: _Channel, cursor: int) -> AsyncGenerator[Message]:
        live = False
        while True:
            changed = channel.changed
            ahead = cursor > channel.newest  # a cursor of another life of this session
            if ahead or (live and channel.newest - cursor > self._max_lag):
                cursor = channel.newest
                yield Message("resync-required", cursor)
            for event in await self._events(session_id, channel, cursor):
                yield Message("estimate", event.seq, event.document)
                cursor = event.seq
            if cursor < channel.newest and channel.ended is None:
                continue
            live = True
            if channel.ended is not None:
                yield Message("end", cursor, reason=channel.ended)
                return
            try:
                await asyncio.wait_for(changed.wait(), self._heartbeat_s)
            except TimeoutError:
                yield Message("heartbeat", cursor)

    async def _events(self, session_id: SessionKey, channel: _Channel, cursor: int) -> list[StoredEvent]:
        if cursor >= channel.newest:
            return []
        recent = channel.since(cursor)
        if recent is not None:
            return recent
        newest = channel.newest
        events = await self._database.read(frames.event_page, session_id, cursor, PAGE)
        if not events and channel.newest == newest:  # said late, before the session was put back with fewer frames
            channel.newest = cursor
        return events

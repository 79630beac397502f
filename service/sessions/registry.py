"""Sessions in memory: created, restored on their next call, evicted when idle. The store has the truth."""

from __future__ import annotations

import asyncio
import time
import uuid
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from typing import Any
from weakref import WeakValueDictionary

import structlog

from service.errors import StaleOwnerError, StoppingError, StorageError
from service.inference.params import SessionConfig
from service.sessions import config as session_config
from service.sessions.archive import session_document
from service.sessions.contenders import Contender
from service.sessions.frame import format_time
from service.sessions.library import articulation_of
from service.sessions.ranging import orbit_warnings
from service.sessions.session import Rooms, Session
from service.store import checkpoints, instances, models, sessions
from service.store.base import NO_QUOTAS, Quotas, SessionRecord, SessionStamp, StoredContender
from service.store.checkpoints import StoredSession
from service.store.instances import Instance
from service.store.scope import SessionKey, model_key, session_key

log = structlog.get_logger(__name__)


class Registry:
    """Hands out the one owner of each session."""

    def __init__(
        self, rooms: Rooms, *, idle_s: float, max_resident: int, quotas: Quotas = NO_QUOTAS, me: str | None = None
    ) -> None:
        self._rooms = rooms
        self._me = me  # this process, where others share the database
        self._idle_s = idle_s
        self._max_resident = max_resident
        self._quotas = quotas
        self._resident: dict[SessionKey, Session] = {}
        self._locks: WeakValueDictionary[SessionKey, asyncio.Lock] = WeakValueDictionary()
        self._closed = False
        self._leaving: set[asyncio.Task[None]] = set()

    @property
    def resident(self) -> Mapping[SessionKey, Session]:
        """Sessions in memory."""
        return self._resident

    @property
    def waiting_frames(self) -> int:
        """Frames waiting or under way."""
        return sum(owner.inbox.size for owner in self._resident.values())

    async def create(
        self, tenant: str, model_ids: Sequence[str], name: str | None, sections: Mapping[str, Any]
    ) -> dict[str, Any]:
        """A new session of a tenant; of several models, one that compares them.

        Raises ``NotFoundError`` for a model, ``QuotaExceededError``, ``ConfigError`` for the rest.
        """
        sections, left_out = session_config.without_retired(sections)
        config = session_config.effective(sections)
        odd = await asyncio.to_thread(orbit_warnings, config)  # refused now, not with a frame
        warnings = [*left_out, *session_config.unused(sections, config), *odd]
        keys = [model_key(tenant, model_id) for model_id in model_ids]
        for key in keys:
            model = await self._rooms.database.read(models.get, key)
            warnings += session_config.check_joints(config, articulation_of(model))
        now = format_time(datetime.now(UTC))
        record = SessionRecord(
            id=session_key(tenant, str(uuid.uuid4())),
            tenant=tenant,
            model_id=keys[0],
            name=name,
            config=session_config.document(config),
            warnings=tuple(dict.fromkeys(warnings)),
            model_ids=tuple(keys) if len(keys) > 1 else (),
            created_at=now,
            updated_at=now,
        )
        await self._rooms.database.write(sessions.add, record, self._quotas)
        return session_document(record)

    async def get(self, session_id: SessionKey) -> Session:
        """The session's owner, restored from the store if not in memory.

        Raises ``NotFoundError``, or ``StaleOwnerError`` where another process has it.
        """
        found = await self.find(session_id)
        if isinstance(found, Instance):
            raise StaleOwnerError("another process has the session")
        return found

    async def find(self, session_id: SessionKey, gone: str | None = None) -> Session | Instance:
        """The same, or the other process that has it, unless that is ``gone``. Raises ``NotFoundError``."""
        owner = self._resident.get(session_id)
        if owner is None or owner.inbox.retired:
            other = await self.peer(session_id)
            if other is not None and other.id != gone:
                return other
            async with self._lock(session_id):
                owner = self._resident.get(session_id)
                if owner is None or owner.inbox.retired:
                    found = await self._restore(session_id, gone)
                    if isinstance(found, Instance):
                        return found
                    owner = found
        owner.inbox.used_at = time.monotonic()
        return owner

    async def peer(self, session_id: SessionKey) -> Instance | None:
        """The other process that has the session now; None: this one, or nobody."""
        if self._me is None:
            return None
        found = await self._rooms.database.read(instances.owner, session_id)
        return None if found is None or found.id == self._me else found

    async def hand_over(self, session_id: SessionKey, to: str) -> None:
        """Give a session of this process to another, after the frames that are here. Raises ``StaleOwnerError``."""
        async with self._lock(session_id):
            owner = self._resident.pop(session_id, None)
            if owner is not None:
                await owner.inbox.drain()
            given = owner is not None and self._me is not None and await self._release(owner, to)
        if not given:
            raise StaleOwnerError("the session was not here any more")
        log.info("session handed over", session_id=session_id, to=to)

    def forget(self, session_id: SessionKey) -> None:
        """Let a session leave memory that was changed elsewhere."""
        owner = self._resident.get(session_id)
        if owner is not None:
            self._let_go(owner)

    async def require_room(self, session_id: SessionKey) -> None:
        """Refuse early, before a body is read: an unknown session, a full inbox."""
        owner = self._resident.get(session_id)
        if owner is None:
            await self._rooms.database.read(sessions.get, session_id)
        else:
            owner.inbox.require_room()

    async def remove(self, session_id: SessionKey, stamp: SessionStamp | None = None) -> None:
        """Delete a session with its history, and send its watchers home; with ``stamp`` only while that is true."""
        async with self._lock(session_id):
            owner = self._resident.pop(session_id, None)
            if owner is not None:
                await owner.inbox.close()
            await self._rooms.database.free(sessions.remove, session_id, stamp)
        self._rooms.hub.end(session_id, "deleted")

    async def take_in(self, given: StoredSession) -> bool:
        """Store a session that comes from elsewhere. Returns whether it is new here; raises ``ConflictError``."""
        async with self._lock(given.record.id):
            owner = self._resident.pop(given.record.id, None)
            if owner is not None:
                await owner.inbox.close()
            new = await self._rooms.database.write(checkpoints.write, given, self._quotas)
        self._rooms.hub.advance(given.record.id, given.record.next_seq - 1)
        return new

    def evict(self) -> int:
        """Let idle sessions leave memory. Returns how many."""
        by_age = sorted(self._resident.values(), key=lambda owner: owner.inbox.used_at)
        surplus = len(by_age) - self._max_resident
        oldest = time.monotonic() - self._idle_s
        idle = [owner for owner in by_age if owner.inbox.idle]
        leaving = [owner for n, owner in enumerate(idle) if n < surplus or owner.inbox.used_at < oldest]
        for owner in leaving:
            self._let_go(owner)
        return len(leaving)

    async def close(self) -> None:
        """Finish every frame in hand."""
        self._closed = True
        owners = list(self._resident.values())
        self._resident.clear()
        await asyncio.gather(*(owner.inbox.close() for owner in owners), *self._leaving)

    def _lock(self, session_id: SessionKey) -> asyncio.Lock:
        lock = self._locks.get(session_id)
        if lock is None:
            lock = self._locks[session_id] = asyncio.Lock()
        return lock

    async def _restore(self, session_id: SessionKey, gone: str | None) -> Session | Instance:
        if self._closed:
            raise StoppingError("the service is shutting down")
        old = self._resident.pop(session_id, None)
        if old is not None:
            await old.inbox.close()
        claimed = await self._rooms.database.write(sessions.claim, session_id, self._me, gone)
        if isinstance(claimed, Instance):
            return claimed
        record, state = claimed
        config = session_config.stored(record.config)
        owner = Session(self._rooms, record, config, await self._contenders(record, config, state))
        self._resident[session_id] = owner
        log.info("session restored", session_id=session_id, next_index=record.next_index)
        return owner

    async def _contenders(
        self, record: SessionRecord, config: SessionConfig, state: bytes | None
    ) -> tuple[Contender, ...]:
        database = self._rooms.database
        compared = await database.read(sessions.compared, record.id)
        if not compared:
            compared = [StoredContender(record.model_id, state, 0.0)]
        return tuple(
            [
                Contender.of(await database.read(models.get, one.model_id), config, one.state, one.log_evidence)
                for one in compared
            ]
        )

    def _let_go(self, owner: Session) -> None:
        del self._resident[owner.record.id]
        task = asyncio.create_task(self._leave(owner))
        self._leaving.add(task)
        task.add_done_callback(self._leaving.discard)

    async def _leave(self, owner: Session) -> None:
        await owner.inbox.close()
        if self._me is not None:
            try:
                await self._release(owner)
            except StorageError as error:
                log.warning("session not released; its lease ends with this process", error=error.detail)

    async def _release(self, owner: Session, to: str | None = None) -> bool:
        assert self._me is not None, "only where several processes share the database"
        record = owner.record
        return await self._rooms.database.write(instances.release, record.id, record.epoch, self._me, to)

"""Calls of one session, run one at a time in the order of their arrival."""

from __future__ import annotations

import asyncio
import contextvars
import time
from collections.abc import Awaitable, Callable
from dataclasses import dataclass
from typing import Any, Literal, TypeVar

import structlog

from service.errors import (
    SkyposeError,
    StaleOwnerError,
    StoppingError,
    StorageError,
)
from service.sessions.line import Line
from service.store.scope import SessionKey, tenant_of

log = structlog.get_logger(__name__)
R = TypeVar("R")


@dataclass
class _Item:
    run: Callable[[], Awaitable[Any]]
    answer: asyncio.Future[Any]
    since: float
    log_context: dict[str, Any]  # of the call: its request id


class Inbox:
    """A bounded queue and the task that empties it."""

    def __init__(self, name: SessionKey, line: Line, waited: Callable[[float], None]) -> None:
        self.retired = False  # the owner's memory may no longer be the truth: restore it from the store
        self.used_at = time.monotonic()
        self._name = name
        self._tenant = tenant_of(name)
        self._line = line
        self._waited = waited
        self._items: asyncio.Queue[_Item | None] = asyncio.Queue()
        self._in_hand = self._failed = False
        self._ending: Literal["no", "close", "drain"] = "no"
        self._task = asyncio.create_task(self._run(), name=f"session {name}", context=contextvars.Context())

    @property
    def idle(self) -> bool:
        """Whether nothing waits and nothing is under way."""
        return not self._in_hand and self._items.empty()

    @property
    def size(self) -> int:
        """Calls that wait or are under way."""
        return self._items.qsize() + self._in_hand

    def require_room(self) -> None:
        """Raise ``InboxFullError`` or ``BusyError`` where one more call would be refused."""
        self._line.require_room(self._tenant, self._items.qsize())

    def put(self, run: Callable[[], Awaitable[R]]) -> asyncio.Future[R]:
        """Queue a call; the future holds its result."""
        if self._ending == "close":
            raise StoppingError("the session is being closed")
        if self._ending == "drain":
            raise StaleOwnerError("the session moves to another process")
        self.require_room()
        self.used_at = time.monotonic()
        answer: asyncio.Future[R] = asyncio.get_running_loop().create_future()
        context = structlog.contextvars.get_contextvars()
        self._items.put_nowait(_Item(run, answer, time.monotonic(), context))
        self._line.enter(self._tenant)
        return answer

    async def close(self) -> None:
        """Finish the call in hand, refuse those that wait, end."""
        await self._end("close")

    async def drain(self) -> None:
        """Finish every call that is here, refuse those that come, end."""
        await self._end("drain")

    async def _end(self, how: Literal["close", "drain"]) -> None:
        first, self._ending, self.retired = self._ending == "no", how, True
        if first:
            self._items.put_nowait(None)
        await self._task

    async def _run(self) -> None:
        while (item := await self._items.get()) is not None:
            self._waited(time.monotonic() - item.since)
            self._in_hand = True
            with structlog.contextvars.bound_contextvars(**(item.log_context | {"session_id": self._name})):
                await self._answer(item)
            self._in_hand = False
            self._line.leave(self._tenant)
            self.used_at = time.monotonic()

    async def _answer(self, item: _Item) -> None:
        try:
            result = await self._result(item)
        except Exception as error:
            if not isinstance(error, SkyposeError):
                log.exception("session call failed")
            if isinstance(error, StorageError | StaleOwnerError):
                self.retired = self._failed = True  # whether the write took place is uncertain
            if not item.answer.done():
                item.answer.set_exception(error)
        else:
            if not item.answer.done():
                item.answer.set_result(result)

    async def _result(self, item: _Item) -> Any:
        if self._ending == "close":
            raise StoppingError("the session is being closed")
        if self._failed:
            raise StaleOwnerError("the session is being restored")
        return await item.run()

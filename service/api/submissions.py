"""Frames whose client does not wait (``Prefer: respond-async``): what became of each, by its key.

A frame that was tracked is found in the store for good. Here are only those under way, and the newest failures.
"""

from __future__ import annotations

import asyncio
from collections import OrderedDict
from collections.abc import Awaitable

from service.access.principal import SessionKey
from service.errors import SkyposeError

KEPT_FAILURES = 1000


class Submissions:
    """Frames under way and failed, by session and key."""

    def __init__(self) -> None:
        self._pending: dict[tuple[SessionKey, str], asyncio.Task[None]] = {}
        self._failed: OrderedDict[tuple[SessionKey, str], SkyposeError] = OrderedDict()

    def follow(self, session_id: SessionKey, key: str, answer: Awaitable[object]) -> None:
        """Remember the frame until its answer is there."""
        place = (session_id, key)
        self._failed.pop(place, None)
        task = asyncio.create_task(self._await(place, answer))
        self._pending[place] = task
        task.add_done_callback(lambda done: self._drop(place, done))

    def pending(self, session_id: SessionKey, key: str) -> bool:
        """Whether the frame is under way. Raises the error of one that failed."""
        failure = self._failed.get((session_id, key))
        if failure is not None:
            raise failure
        return (session_id, key) in self._pending

    async def close(self) -> None:
        """Wait for those under way."""
        await asyncio.gather(*self._pending.values())

    async def _await(self, place: tuple[SessionKey, str], answer: Awaitable[object]) -> None:
        try:
            await answer
        except SkyposeError as error:
            self._fail(place, error)
        except Exception as error:  # noqa: BLE001 -- logged by the session; the client gets the general answer
            self._fail(place, SkyposeError(f"unexpected error: {type(error).__name__}"))

    def _fail(self, place: tuple[SessionKey, str], error: SkyposeError) -> None:
        self._failed[place] = error
        while len(self._failed) > KEPT_FAILURES:
            self._failed.popitem(last=False)

    def _drop(self, place: tuple[SessionKey, str], task: asyncio.Task[None]) -> None:
        if self._pending.get(place) is task:
            del self._pending[place]

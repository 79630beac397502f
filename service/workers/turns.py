"""Work beside the tracking in turn: whoever has had most of it waits longest, however much of it they ask for."""

from __future__ import annotations

import asyncio
import time
from collections import deque
from collections.abc import Awaitable, Callable
from typing import TypeVar

R = TypeVar("R")

MOST_DEBT_S = 60.0  # what was had long ago is forgiven
KEPT = 1000  # tenants whose work is remembered


class Turns:
    """A queue per tenant before so many ``places`` (start-time fair queueing, Goyal, Vin and Cheng 1996).

    A turn begins for a tenant, in seconds of work, where its last one ended, but not before the turn that was given
    last began: nobody saves up. Of those that wait, the one that begins first is next. Used by one thread, the event
    loop's.
    """

    def __init__(self, places: Callable[[], int]) -> None:
        self._places = places
        self._taken = 0
        self._now = 0.0
        self._ends: dict[str, float] = {}
        self._waiting: dict[str, deque[asyncio.Future[None]]] = {}

    async def run(self, tenant: str, job: Callable[[], Awaitable[R]]) -> R:
        """What the job gives, begun when it is the tenant's turn.

        Whoever stops waiting for a job that has begun does not stop it: it keeps its turn until it is over.
        """
        if self._taken < self._places() and not self._waiting:
            self._taken += 1
        else:
            await self._wait(tenant)
        return await asyncio.shield(asyncio.create_task(self._have_turn(tenant, job)))

    async def _have_turn(self, tenant: str, job: Callable[[], Awaitable[R]]) -> R:
        began = self._begin(tenant)
        started = time.monotonic()
        try:
            return await job()
        finally:
            end = max(self._ends.pop(tenant, 0.0), began) + time.monotonic() - started
            self._ends[tenant] = min(end, self._now + MOST_DEBT_S)
            if len(self._ends) > KEPT:
                del self._ends[next(iter(self._ends))]
            self._pass_on()

    async def _wait(self, tenant: str) -> None:
        turn = asyncio.get_running_loop().create_future()
        self._waiting.setdefault(tenant, deque()).append(turn)
        try:
            await turn
        except asyncio.CancelledError:
            if turn.done() and not turn.cancelled():  # given, and never used
                self._pass_on()
            raise

    def _begin(self, tenant: str) -> float:
        self._now = max(self._now, self._ends.get(tenant, 0.0))
        return self._now

    def _pass_on(self) -> None:
        for tenant in sorted(self._waiting, key=lambda name: max(self._ends.get(name, 0.0), self._now)):
            queue = self._waiting[tenant]
            while queue:
                turn = queue.popleft()
                if not turn.done():  # else its caller has gone
                    self._drop_empty()
                    turn.set_result(None)
                    return
        self._drop_empty()
        self._taken -= 1

    def _drop_empty(self) -> None:
        self._waiting = {tenant: queue for tenant, queue in self._waiting.items() if queue}

"""Turns at what does one thing at a time, shared between tenants by the time that each one's turns take.

Start-time fair queueing (Goyal, Vin and Cheng 1996): who has had least is next, and whoever was away begins level
with those who stayed. Turns cannot be interrupted, so two rules are added. A tenant that comes back at once after
each turn is waited for a moment before one that has had more begins something long. And time that was spent on what
had to be refused is paid back: its tenant stands aside for a multiple of it while others are about.
"""

from __future__ import annotations

import asyncio
import math
import time
from collections import defaultdict, deque
from collections.abc import Awaitable, Callable
from dataclasses import dataclass
from typing import TypeVar

from service.errors import InputError

R = TypeVar("R")

PROMPT_S = 0.1
"""A client that posts as fast as it is answered is back within this, and differences of so much are none."""
REPAID = 6.0
"""Seconds of standing aside for each that was wasted: who sends nothing else has a seventh of the time."""
LONGEST_ASIDE_S = 25.0
"""Less than a stop of the service waits for frames in hand (SKYPOSE_SHUTDOWN_GRACE_S); repays waste of four seconds."""
ABOUT_S = 60.0
"""A tenant counts as being about for so long after its last turn: longer than between frames of any telescope."""
KNOWN_TENANTS = 1000
"""Beyond so many, those that are not about any more are forgotten."""
SEEN: dict[str, float] = {}
"""When each tenant came or was done last, over all queues of this process: they share its machine."""
_LONGEST_PAUSE_S = 10 * PROMPT_S


@dataclass
class _Tenant:
    had_s: float = 0.0  # time of its turns, and of those that it was not there for: its start tag
    waiting: int = 0
    began_s: float | None = None
    left_s: float = -math.inf
    pause_s: float = _LONGEST_PAUSE_S  # between turns, as a mean that forgets
    aside_until_s: float = -math.inf

    @property
    def away(self) -> bool:
        return not self.waiting and self.began_s is None


class FairOrder:
    """Whose turn it is. Knows no clock: every moment (seconds) is told. ``seen``: see ``SEEN``."""

    def __init__(self, seen: dict[str, float] | None = None) -> None:
        self._seen = {} if seen is None else seen
        self._tenants: dict[str, _Tenant] = {}
        self._level_s = 0.0  # what the one whose turn it is had had before

    def come(self, name: str, now: float) -> None:
        """A tenant waits for one turn more."""
        tenant = self._tenants.setdefault(name, _Tenant())
        if tenant.away:
            tenant.had_s = max(tenant.had_s, self._level_s)
            tenant.pause_s = (tenant.pause_s + min(now - tenant.left_s, _LONGEST_PAUSE_S)) / 2
        tenant.waiting += 1
        self._seen[name] = now

    def leave(self, name: str) -> None:
        """A tenant waits for one turn less."""
        self._tenants[name].waiting -= 1

    def begin(self, now: float) -> tuple[str | None, float]:
        """Who has the turn now; or nobody, and when to ask again (infinity: after the next who comes)."""
        waiting = {name: tenant for name, tenant in self._tenants.items() if tenant.waiting}
        ready = {n: t for n, t in waiting.items() if t.aside_until_s <= now or not self._others(n, now)}
        if not ready:
            return None, min((tenant.aside_until_s for tenant in waiting.values()), default=math.inf)
        name = min(ready, key=lambda one: ready[one].had_s)
        tenant = ready[name]
        expected = [other.left_s + PROMPT_S for other in self._tenants.values() if _comes_first(other, tenant, now)]
        if expected:
            return None, min(expected)
        tenant.waiting -= 1
        tenant.began_s = now
        self._level_s = tenant.had_s
        return name, math.inf

    def ready(self, name: str, now: float) -> None:
        """The turn counts from now on."""
        self._tenants[name].began_s = now

    def end(self, name: str, now: float, *, wasted: bool) -> None:
        """The turn is over; ``wasted``: what was sent had to be refused."""
        tenant = self._tenants[name]
        assert tenant.began_s is not None, "it has the turn"
        took = now - tenant.began_s
        tenant.had_s += took
        tenant.began_s, tenant.left_s = None, now
        self._seen[name] = now
        if wasted:
            tenant.aside_until_s = now + min(REPAID * took, LONGEST_ASIDE_S)
        if len(self._tenants) > KNOWN_TENANTS:
            self._tenants = {n: t for n, t in self._tenants.items() if not t.away or now - t.left_s < ABOUT_S}
            for gone in [n for n, seen_s in self._seen.items() if now - seen_s >= ABOUT_S]:
                del self._seen[gone]

    def _others(self, name: str, now: float) -> bool:
        return any(now - seen_s < ABOUT_S for other, seen_s in self._seen.items() if other != name)


def _comes_first(other: _Tenant, tenant: _Tenant, now: float) -> bool:
    """Whether one that is away is expected back, and has had less."""
    prompt = other.away and other.pause_s < PROMPT_S and now - other.left_s < PROMPT_S
    return prompt and other.had_s + PROMPT_S < tenant.had_s


class FairQueue:
    """The order as something to wait for, on one event loop."""

    def __init__(self, seen: dict[str, float] | None = None) -> None:
        self._order = FairOrder(seen)
        self._waiting: defaultdict[str, deque[asyncio.Future[None]]] = defaultdict(deque)
        self._busy = False
        self._again: asyncio.TimerHandle | None = None

    async def run(self, tenant: str, ready: Callable[[], Awaitable[object]], job: Callable[[], Awaitable[R]]) -> R:
        """What the job gives, begun when it is the tenant's turn. An ``InputError`` out of it was a waste.

        ``ready`` brings up what does the job: time that is nobody's. Whoever stops waiting for a job that has begun
        does not stop it: it keeps its turn until it is over.
        """
        await self._wait(tenant)
        return await asyncio.shield(asyncio.create_task(self._have_turn(tenant, ready, job)))

    async def _have_turn(
        self, tenant: str, ready: Callable[[], Awaitable[object]], job: Callable[[], Awaitable[R]]
    ) -> R:
        wasted = False
        try:
            await ready()
            self._order.ready(tenant, time.monotonic())
            return await job()
        except InputError:
            wasted = True
            raise
        finally:
            self._end(tenant, wasted=wasted)

    async def _wait(self, tenant: str) -> None:
        turn = asyncio.get_running_loop().create_future()
        self._waiting[tenant].append(turn)
        self._order.come(tenant, time.monotonic())
        self._next()
        try:
            await asyncio.shield(turn)
        except asyncio.CancelledError:
            if turn.done():  # it came in the same moment
                self._end(tenant, wasted=False)
            else:
                self._waiting[tenant].remove(turn)
                self._order.leave(tenant)
            raise

    def _end(self, tenant: str, *, wasted: bool) -> None:
        self._busy = False
        self._order.end(tenant, time.monotonic(), wasted=wasted)
        self._next()

    def _next(self) -> None:
        if self._busy:
            return
        if self._again is not None:
            self._again.cancel()
            self._again = None
        now = time.monotonic()
        tenant, again = self._order.begin(now)
        if tenant is not None:
            self._busy = True
            waiting = self._waiting[tenant]
            waiting.popleft().set_result(None)
            if not waiting:
                del self._waiting[tenant]
        elif again < math.inf:
            self._again = asyncio.get_running_loop().call_later(again - now, self._next)

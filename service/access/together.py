"""Questions of many callers, asked of a slow answerer together."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Mapping, Sequence
from typing import Generic, TypeVar

R = TypeVar("R")
Asking = Callable[[Sequence[str]], Awaitable[Mapping[str, R]]]


class Together(Generic[R]):
    """Asks for all names that came up since it asked last, no more often than every ``apart_s`` seconds.

    So a flood of names costs no more than the few questions that fit into its time; a lone name does not wait.
    """

    def __init__(self, ask: Asking[R], apart_s: float) -> None:
        self._ask = ask
        self._apart_s = apart_s
        self._names: set[str] = set()
        self._next: asyncio.Task[Mapping[str, R]] | None = None
        self._earliest = 0.0

    async def get(self, name: str) -> R | None:
        """The answer on a name; None where there is none. Raises what asking raises."""
        self._names.add(name)
        if self._next is None:
            self._next = asyncio.create_task(self._answers())
        return (await asyncio.shield(self._next)).get(name)  # whoever gives up takes nobody along

    async def _answers(self) -> Mapping[str, R]:
        clock = asyncio.get_running_loop()
        await asyncio.sleep(self._earliest - clock.time())
        names, self._names, self._next = sorted(self._names), set(), None
        self._earliest = clock.time() + self._apart_s
        return await self._ask(names)

"""Workers that sleep until a job would have to wait for another, and again when they have rested long enough."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Coroutine, Iterable, Mapping
from typing import Any

import structlog

from service.errors import StoppingError, WorkerFailedError
from service.workers.child_process import WorkerLostError
from service.workers.placement import Placement
from service.workers.process import WorkerProcess

log = structlog.get_logger(__name__)
Run = Callable[[str, object], Awaitable[Any]]
"""Runs a method of one worker on a job."""
Prepare = Callable[[Run], Awaitable[Iterable[str]]]
"""Has that worker prepare what is tracked at the time; gives the keys of its models."""


async def nothing(_run: Run) -> Iterable[str]:
    """Prepare nothing."""
    return ()


class Sleepers:
    """Says to a ``Placement`` which of these workers take jobs. Used by one thread, the event loop's."""

    def __init__(self, workers: Mapping[str, WorkerProcess], placement: Placement, rest_s: float) -> None:
        self._workers = workers
        self._placement = placement
        self._rest_s = rest_s
        self._asleep = list(workers)
        self._resting: dict[str, asyncio.TimerHandle] = {}
        self._tasks: set[asyncio.Task[None]] = set()
        self._wakes = False
        self.prepare: Prepare = nothing

    @property
    def asleep(self) -> frozenset[str]:
        """Those that no job is given to."""
        return frozenset(self._asleep)

    def given(self, worker: str) -> None:
        """A worker was given a job. Where it has to wait there, another worker wakes; one at a time."""
        if (rest := self._resting.pop(worker, None)) is not None:
            rest.cancel()
        if self._asleep and not self._wakes and self._placement.load(worker) > 1:
            self._wakes = True
            self._begin(self._wake(self._asleep[0]))

    def done(self, worker: str) -> None:
        """A worker's job has ended; without another it sleeps after a while."""
        if worker in self._workers and self._placement.load(worker) == 0:
            self._resting[worker] = asyncio.get_running_loop().call_later(self._rest_s, self._rested, worker)

    async def close(self) -> None:
        """Wait for those that are just waking, or going to sleep."""
        for rest in self._resting.values():
            rest.cancel()
        await asyncio.gather(*self._tasks)

    def _begin(self, change: Coroutine[Any, Any, None]) -> None:
        self._tasks.add(task := asyncio.create_task(change))
        task.add_done_callback(self._tasks.discard)

    async def _wake(self, worker: str) -> None:
        try:
            await self._workers[worker].start()
            models = await self.prepare(self._workers[worker].call_once)
        except (WorkerFailedError, WorkerLostError) as error:  # the others go on; the next job that waits tries again
            log.warning("worker did not wake", worker=worker, reason=str(error))
        except StoppingError:
            return
        else:
            self._asleep.remove(worker)
            self._placement.add(worker, models)
            self.done(worker)  # it may be that no job is left for it
        finally:
            self._wakes = False

    def _rested(self, worker: str) -> None:
        del self._resting[worker]
        if worker in self._placement.workers and self._placement.load(worker) == 0:
            self._placement.remove(worker)
            self._begin(self._sleep(worker))

    async def _sleep(self, worker: str) -> None:
        await self._workers[worker].sleep()
        log.info("worker sleeps", worker=worker)
        self._asleep.append(worker)

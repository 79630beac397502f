"""A worker in a thread of this process: for tests and offline use."""

from __future__ import annotations

import asyncio
import pickle
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any

from service.workers.base import Worker
from service.workers.host import execute
from service.workers.sleepers import Prepare


class InlineTransport:
    """Transport that runs every job in one thread, which also builds and closes the worker."""

    def __init__(self, factory: Callable[[], Worker]) -> None:
        self._factory = factory
        self._thread = ThreadPoolExecutor(1, thread_name_prefix="worker")
        self._worker: Worker | None = None
        self.restarts = 0

    @property
    def ready(self) -> bool:
        """Whether jobs can run at once."""
        return self._worker is not None

    @property
    def places(self) -> int:
        """One thread does everything."""
        return 1

    def processes(self) -> Sequence[Mapping[str, Any]]:
        """None: jobs run in this process."""
        return ()

    def prestart(self) -> None:
        """There is nothing to begin early."""

    def on_wake(self, prepare: Prepare) -> None:
        """None sleeps."""

    async def start(self) -> None:
        """Build the worker."""
        self._worker = await asyncio.get_running_loop().run_in_executor(self._thread, self._factory)

    async def call(self, key: str | None, method: str, job: object) -> Any:
        """Run ``method`` on ``job``; raises what the worker raises."""
        assert self._worker is not None, "start() comes first"
        # Through pickle as in a process: a job that could not travel must fail in the quick tests too.
        copy = pickle.loads(pickle.dumps(job, protocol=5))
        loop = asyncio.get_running_loop()
        return await loop.run_in_executor(self._thread, execute, self._worker, method, copy)

    async def close(self) -> None:
        """Close the worker in its own thread."""
        if self._worker is not None:
            await asyncio.get_running_loop().run_in_executor(self._thread, self._worker.close)
            self._worker = None
        self._thread.shutdown()

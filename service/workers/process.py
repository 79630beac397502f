"""Workers in processes of their own: a death, a hang or a lost device costs a retry, never a session.

A job is pure (state in, state out), so it can simply be run again. One thread per process owns it: it alone
feeds, reads and ends it; the event loop only awaits.
"""

from __future__ import annotations

import asyncio
import pickle
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import structlog

from service.errors import SkyposeError, StoppingError, WorkerFailedError
from service.workers.child_process import ChildProcess, Program, WorkerLostError, WorkerTimeoutError
from service.workers.interpreter import Interpreter
from service.workers.limits import DecodeLimits
from service.workers.spare import Spare

log = structlog.get_logger(__name__)
TRACKER = "service.workers.guarded:guarded"
_TIMEOUT_SETTING = "SKYPOSE_WORKER_TIMEOUT_S"


def tracker_program(settings: Mapping[str, Any], factory: str | None = None) -> Program:
    """The tracker as a program, with the limits and folders of the process's settings; or another ``factory``."""
    kernels = settings["data_dir"] / "kernels"
    arguments = (DecodeLimits.of(settings), kernels) if factory is None else ()
    nice, start_timeout_s = settings["worker_nice"], settings["worker_start_timeout_s"]
    return Program(factory or TRACKER, arguments, nice, start_timeout_s=start_timeout_s)


def timed_out(error: SkyposeError) -> bool:
    """Whether a job failed because it took too long, and would do so again."""
    return error.facts.get("setting") == _TIMEOUT_SETTING


class WorkerProcess:
    """One worker process, had when first needed and again after each loss: the spare, else one started now."""

    def __init__(
        self,
        name: str,
        program: Program,
        timeout_s: float,
        spare: Spare | None = None,
        first: Interpreter | None = None,
    ) -> None:
        """``first``: an interpreter that was started ahead, for the first process."""
        self.name = name
        self.restarts = 0
        self._program = program
        self._timeout_s = timeout_s
        self._spare = spare
        self._first = first
        self._child: ChildProcess | None = None
        self._closing = False
        self._thread = ThreadPoolExecutor(1, thread_name_prefix=f"worker-{name}")

    @property
    def ready(self) -> bool:
        """Whether the process is up."""
        return self._child is not None

    @property
    def pid(self) -> int | None:
        """Process id, or None while it is down."""
        child = self._child
        return None if child is None else child.pid

    def prestart(self) -> None:
        """Begin to bring the process up, without waiting: ``start`` waits, and says what went wrong."""
        self._thread.submit(self._up)

    async def start(self) -> None:
        """Bring the process up. Raises ``WorkerFailedError`` where it cannot be built."""
        if self._closing:
            raise StoppingError("the service is shutting down")
        if not self.ready:
            await self._in_thread(self._up)

    async def call(self, method: str, job: object) -> Any:
        """Run a job; on a loss once more in a new process, then ``WorkerFailedError``. What timed out is not."""
        try:
            return await self.call_once(method, job)
        except WorkerLostError:
            try:
                return await self.call_once(method, job)
            except WorkerLostError as loss:
                raise WorkerFailedError(f"the worker failed twice during {method}") from loss

    async def call_once(self, method: str, job: object) -> Any:
        """Run a job. Raises ``WorkerLostError`` where the process is lost over it; the next job has another.

        ``WorkerFailedError`` where it does not answer in time: a second try would take as long again.
        """
        if self._closing:
            raise StoppingError("the service is shutting down")
        return await self._in_thread(self._call, method, job)

    async def sleep(self) -> None:
        """End the process, once it has nothing in hand; ``start`` or the next job brings another up."""
        await self._in_thread(self._down)

    async def close(self) -> None:
        """Finish the job in hand, then end the process. A second call does nothing."""
        if self._closing:
            return
        self._closing = True
        await self._in_thread(self._down)
        self._thread.shutdown()

    async def _in_thread(self, function: Callable[..., Any], *args: object) -> Any:
        return await asyncio.get_running_loop().run_in_executor(self._thread, function, *args)

    def _call(self, method: str, job: object) -> Any:
        child = self._up()
        try:
            return child.exchange(pickle.dumps((method, job), protocol=5), self._timeout_s)
        except WorkerLostError as loss:
            self._lose(child, method, str(loss))
            if isinstance(loss, WorkerTimeoutError):
                detail = f"{method}: {loss}; it is not tried again"
                raise WorkerFailedError(detail, limit=self._timeout_s, setting=_TIMEOUT_SETTING) from loss
            raise

    def _up(self) -> ChildProcess:
        if self._child is None:
            self._child = (self._spare.take() if self._spare else None) or self._started()
            log.info("worker started", worker=self.name, pid=self._child.pid)
        return self._child

    def _started(self) -> ChildProcess:
        first, self._first = self._first, None
        child = ChildProcess(self._program, first)
        try:
            child.wait_ready()
            child.wake()
        except WorkerLostError as loss:
            raise WorkerFailedError(f"the worker did not start: {loss}") from loss
        return child

    def _lose(self, child: ChildProcess, method: str, reason: str) -> None:
        self.restarts += 1
        log.warning("worker lost", worker=self.name, method=method, reason=reason, pid=child.pid)
        child.end()
        self._child = None

    def _down(self) -> None:
        child, self._child = self._child, None
        if child is not None:
            child.stop()

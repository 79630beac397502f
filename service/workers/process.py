"""Workers in processes of their own: a death, a hang or a lost device costs a retry, never a session.

A job is pure (state in, state out), so it can simply be run again. One thread per process owns it: it alone
starts, feeds, reads and ends it; the event loop only awaits.
"""

from __future__ import annotations

import asyncio
import multiprocessing
import pickle
import threading
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from multiprocessing.connection import Connection
from multiprocessing.context import SpawnProcess
from multiprocessing.util import Finalize
from typing import Any

import structlog

from service.errors import SkyposeError, StoppingError, WorkerFailedError
from service.workers.child import run

log = structlog.get_logger(__name__)
TRACKER = "service.workers.tracker:guarded"  # takes a DecodeLimits
_CONTEXT = multiprocessing.get_context("spawn")  # fork would copy device contexts and locks


class WorkerLostError(Exception):
    """The process died, hung, or lost its device during a job."""


@dataclass
class _Child:
    process: SpawnProcess
    channel: Connection
    reaper: Finalize  # at exit multiprocessing would send SIGTERM, which workers ignore, and wait


class WorkerProcess:
    """One worker process, started when first needed and again after each loss."""

    def __init__(
        self,
        name: str,
        factory: str,
        timeout_s: float,
        start_timeout_s: float,
        arguments: tuple[Any, ...] = (),
        nice: int = 0,
        threads: int = 1,
    ) -> None:
        self.name = name
        self.description: Mapping[str, Any] = {}
        self.restarts = 0
        self._factory = factory
        self._arguments = arguments  # of the factory: plain data
        self._nice = nice
        self._threads = threads  # of each library that would start one per core
        self._timeout_s = timeout_s
        self._start_timeout_s = start_timeout_s
        self._child: _Child | None = None
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
        return None if child is None else child.process.pid

    def prestart(self) -> None:
        """Begin to bring the process up, without waiting: ``start`` waits, and says what went wrong."""
        self._thread.submit(self._up)

    async def start(self) -> None:
        """Bring the process up. Raises ``WorkerFailedError`` where it cannot be built."""
        await self._in_thread(self._up)

    async def call(self, method: str, job: object) -> Any:
        """Run a job; on a loss once more in a new process, then ``WorkerFailedError``."""
        if self._closing:
            raise StoppingError("the service is shutting down")
        return await self._in_thread(self._call, method, job)

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
        message = pickle.dumps((method, job), protocol=5)
        for last_try in (False, True):
            child = self._up()
            try:
                return self._exchange(child, message, self._timeout_s)
            except WorkerLostError as loss:
                self._lose(child, method, str(loss))
                if last_try:
                    raise WorkerFailedError(f"the worker failed twice during {method}") from loss
        raise AssertionError("unreachable")

    def _up(self) -> _Child:
        if self._child is not None:
            return self._child
        here, there = _CONTEXT.Pipe()
        arguments = (there, self._factory, self._arguments, self._nice, self._threads)
        process = _CONTEXT.Process(target=run, args=arguments, name=f"skypose-{self.name}", daemon=True)
        process.start()
        there.close()  # so that the end of the process is the end of the pipe
        child = _Child(process, here, Finalize(None, process.kill, exitpriority=10))
        try:
            self.description = {**self._exchange(child, None, self._start_timeout_s), "pid": process.pid}
        except WorkerLostError as loss:
            _end(child)
            raise WorkerFailedError(f"the worker did not start: {loss}") from loss
        self._child = child
        log.info("worker started", worker=self.name, pid=process.pid)
        return child

    def _exchange(self, child: _Child, message: bytes | None, timeout_s: float) -> Any:
        """Send (unless None) and receive. The timer covers both: a stopped process takes nothing either."""
        watchdog = threading.Timer(timeout_s, child.process.kill)
        watchdog.start()
        try:
            if message is not None:
                child.channel.send_bytes(message)
            outcome, payload = pickle.loads(child.channel.recv_bytes())
        except (EOFError, OSError) as error:
            hung = watchdog.finished.is_set()
            raise WorkerLostError(f"no answer in {timeout_s:g} s" if hung else "process died") from error
        finally:
            watchdog.cancel()
        if outcome == "refused":
            raise payload
        if outcome == "broken":
            raise WorkerLostError(payload)
        if outcome == "bug":
            log.error("worker bug", worker=self.name, traceback=payload)
            raise SkyposeError("the worker met an unexpected error; the log has its trace")
        return payload

    def _lose(self, child: _Child, method: str, reason: str) -> None:
        self.restarts += 1
        log.warning("worker lost", worker=self.name, method=method, reason=reason, pid=child.process.pid)
        _end(child)
        self._child = None

    def _down(self) -> None:
        child, self._child = self._child, None
        if child is None:
            return
        try:
            child.channel.send_bytes(b"")
            child.process.join(5.0)
        except OSError:
            log.info("worker was gone already", worker=self.name)
        _end(child)


def _end(child: _Child) -> None:
    child.reaper.cancel()
    child.process.kill()
    child.process.join()
    child.process.close()
    child.channel.close()

"""A worker process as its parent sees it: started, waited for, asked, ended. One thread at a time owns it."""

from __future__ import annotations

import contextlib
import multiprocessing
import pickle
import threading
from dataclasses import dataclass
from multiprocessing.util import Finalize
from typing import Any

import structlog

from service.errors import SkyposeError
from service.workers.child import run

log = structlog.get_logger(__name__)
_CONTEXT = multiprocessing.get_context("spawn")  # fork would copy device contexts and locks


class WorkerLostError(Exception):
    """The process died, hung, or lost its device."""


class WorkerTimeoutError(WorkerLostError):
    """It did not answer in time, and was ended."""


@dataclass(frozen=True)
class Program:
    """What a worker process runs. Plain data."""

    factory: str  # ``package.module:name`` of what builds the worker
    arguments: tuple[Any, ...] = ()  # of the factory
    nice: int = 0
    threads: int = 1  # of each library that would start one per core
    start_timeout_s: float = 60.0


class ChildProcess:
    """Starts at once, without waiting; ``wait_ready`` comes before the first ``exchange``."""

    def __init__(self, program: Program) -> None:
        here, there = _CONTEXT.Pipe()
        arguments = (there, program.factory, program.arguments, program.nice, program.threads)
        self._process = _CONTEXT.Process(target=run, args=arguments, name="skypose-worker", daemon=True)
        self._process.start()
        there.close()  # so that the end of the process is the end of the pipe
        self._channel = here
        self._start_timeout_s = program.start_timeout_s
        # At exit multiprocessing would send SIGTERM, which workers ignore, and wait.
        self._reaper = Finalize(None, self._process.kill, exitpriority=10)
        self.pid = self._process.pid

    def wait_ready(self) -> None:
        """Wait until it takes jobs. Raises ``WorkerLostError``; the process is then ended."""
        self._expect(None)

    def ping(self) -> None:
        """Ask it for nothing. Raises ``WorkerLostError`` where it does not answer; the process is then ended."""
        self._expect(pickle.dumps(("ping", None)))

    def _expect(self, message: bytes | None) -> None:
        try:
            self.exchange(message, self._start_timeout_s)
        except WorkerLostError:
            self.end()
            raise

    def exchange(self, message: bytes | None, timeout_s: float) -> Any:
        """Send (unless None) and receive. The timer covers both: a stopped process takes nothing either.

        Raises what the worker refused with, and ``WorkerLostError``.
        """
        watchdog = threading.Timer(timeout_s, self._kill)
        watchdog.start()
        try:
            if message is not None:
                self._channel.send_bytes(message)
            outcome, payload = pickle.loads(self._channel.recv_bytes())
        except (EOFError, OSError) as error:
            if watchdog.finished.is_set():
                raise WorkerTimeoutError(f"no answer in {timeout_s:g} s") from error
            raise WorkerLostError("process died") from error
        finally:
            watchdog.cancel()
        if outcome == "refused":
            raise payload
        if outcome == "broken":
            raise WorkerLostError(payload)
        if outcome == "bug":
            log.error("worker bug", pid=self.pid, traceback=payload)
            raise SkyposeError("the worker met an unexpected error; the log has its trace")
        return payload

    def stop(self) -> None:
        """Ask it to end, wait a little, and end it."""
        try:
            self._channel.send_bytes(b"")
            self._process.join(5.0)
        except OSError:
            log.info("worker was gone already", pid=self.pid)
        self.end()

    def end(self) -> None:
        """End it at once and release everything."""
        self._reaper.cancel()
        self._process.kill()
        # A thread that starts a process also reaps those that ended: until it has noted how this one ended,
        # join returns at once.
        while self._process.exitcode is None:
            self._process.join()
        self._process.close()
        self._channel.close()

    def _kill(self) -> None:
        with contextlib.suppress(ValueError):  # ended and closed just before the watchdog came
            self._process.kill()

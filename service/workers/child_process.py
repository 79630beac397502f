"""A worker process as its parent sees it: started, waited for, asked, ended. One thread at a time owns it."""

from __future__ import annotations

import contextlib
import pickle
import subprocess
import threading
from dataclasses import dataclass
from typing import Any

import structlog

from service.errors import SkyposeError
from service.workers.interpreter import Interpreter

log = structlog.get_logger(__name__)
_END_S = 5.0  # that a process has to end when it is asked to


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

    def __init__(self, program: Program, interpreter: Interpreter | None = None) -> None:
        """In ``interpreter``, which was started before, or one that is started now."""
        self._interpreter = interpreter or Interpreter()
        self._process, self._channel = self._interpreter.process, self._interpreter.channel
        self._start_timeout_s = program.start_timeout_s
        self.pid = self._process.pid
        message = pickle.dumps((program.factory, program.arguments, program.nice, program.threads))
        with contextlib.suppress(OSError):  # it is gone already: ``wait_ready`` will say so
            self._channel.send_bytes(message)

    def wait_ready(self) -> None:
        """Wait until it takes jobs. Raises ``WorkerLostError``; the process is then ended."""
        self._expect(None)

    def wake(self) -> None:
        """Say that jobs will come. Raises ``WorkerLostError`` where it does not answer; the process is then ended."""
        self._expect(pickle.dumps(("wake", None)))

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
        watchdog = threading.Timer(timeout_s, self._process.kill)
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
            self._process.wait(_END_S)
        except OSError:
            log.info("worker was gone already", pid=self.pid)
        except subprocess.TimeoutExpired:
            log.warning("worker does not end by itself", pid=self.pid)
        self.end()

    def end(self) -> None:
        """End it at once and release everything."""
        self._interpreter.close()

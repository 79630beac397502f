"""A worker process kept ready, so that one that is lost is replaced at once."""

from __future__ import annotations

import threading
from concurrent.futures import Future, ThreadPoolExecutor

import structlog

from service.workers.child_process import ChildProcess, Program, WorkerLostError

log = structlog.get_logger(__name__)


class Spare:
    """One started process, for whichever worker needs one next. Threads may share it."""

    def __init__(self, program: Program) -> None:
        self._program = program
        self._thread = ThreadPoolExecutor(1, thread_name_prefix="worker-spare")
        self._turn = threading.Lock()
        self._next: Future[ChildProcess | None] | None = None
        self._closed = False

    def fill(self) -> None:
        """Begin to start a process, without waiting, unless there is one."""
        with self._turn:
            if self._next is None and not self._closed:
                self._next = self._thread.submit(self._start)

    def take(self) -> ChildProcess | None:
        """The process, ready; None where there is none or it is gone. The next one is begun.

        One that is just starting is waited for: it is further than any that were begun now.
        """
        with self._turn:
            taken, self._next = self._next, None
        child = None if taken is None else taken.result()
        if taken is not None:
            self.fill()
        if child is not None:
            try:
                child.wake()
            except WorkerLostError as loss:
                log.warning("spare worker was gone", reason=str(loss), pid=child.pid)
                return None
        return child

    def close(self) -> None:
        """End it, also where it is just starting."""
        with self._turn:
            self._closed = True
            taken, self._next = self._next, None
        child = None if taken is None else taken.result()
        if child is not None:
            child.stop()
        self._thread.shutdown()

    def _start(self) -> ChildProcess | None:
        try:
            child = ChildProcess(self._program)
            child.wait_ready()
        except (WorkerLostError, OSError) as error:
            log.warning("no spare worker", reason=str(error))
            return None
        return child

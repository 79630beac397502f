"""What a Ray actor does: the worker processes of one GPU, or of some cores, on whatever node Ray puts it.

Jobs and outcomes travel as pickles, and what a worker refuses with is part of the outcome: an exception that Ray
meets is therefore always Ray's own, a loss.
"""

from __future__ import annotations

import asyncio
import contextlib
import os
import pickle
import socket
import sys
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from service.errors import SkyposeError, WorkerFailedError
from service.workers.child_process import Program
from service.workers.pool import Batching, ProcessTransport
from service.workers.process import timed_out

PAGE_BYTES = os.sysconf("SC_PAGE_SIZE")


@dataclass(frozen=True)
class WorkerPlan:
    """What an actor runs. Plain data."""

    program: Program
    processes: int
    timeout_s: float  # of a job
    batching: Batching
    cores: int


class RayWorker:
    """Body of an actor. Its event loop only awaits."""

    def __init__(self, plan: WorkerPlan) -> None:
        # Worker processes would import Ray's main module again, which none of them needs.
        sys.modules["__main__"].__file__ = None
        paths = tuple(a.expanduser() if isinstance(a, Path) else a for a in plan.program.arguments)
        program = replace(plan.program, arguments=paths)
        self._pool = ProcessTransport(program, plan.processes, plan.timeout_s, plan.batching, plan.cores)

    async def start(self) -> dict[str, Any]:
        """Bring the worker processes up. Raises ``WorkerFailedError``."""
        await self._pool.start()
        return {"pid": os.getpid(), "host": socket.gethostname(), "node": _node()}

    async def call(self, message: bytes) -> bytes:
        """Run a job: a pickled (session, method, job) in, a pickled (refusal, answer, bytes of memory) out."""
        session, method, job = pickle.loads(message)
        refusal, answer = None, None
        try:
            answer = await self._pool.call(session, method, job)
        except SkyposeError as error:
            if isinstance(error, WorkerFailedError) and not timed_out(error):
                raise  # it has been tried twice here: elsewhere it may go well
            refusal = error
        return pickle.dumps((refusal, answer, self._memory()), protocol=5)

    async def live(self) -> None:
        """Never answers: whoever waits for it hears of the actor's end at once."""
        await asyncio.get_running_loop().create_future()

    async def close(self) -> None:
        """Finish what is in hand and end the processes."""
        await self._pool.close()

    def _memory(self) -> int:
        total = 0
        for pid in [process["pid"] for process in self._pool.processes()]:
            with contextlib.suppress(FileNotFoundError, ProcessLookupError):  # it has just died
                total += int(Path(f"/proc/{pid}/statm").read_text().split()[1]) if pid else 0
        return total * PAGE_BYTES


def _node() -> str:
    import ray

    return str(ray.get_runtime_context().get_node_id())

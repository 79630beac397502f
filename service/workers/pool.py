"""The worker processes of this machine: some that track, and one beside them.

Those that are not needed sleep: they are had when a job would have to wait for another, and ended when they rest.
"""

from __future__ import annotations

import asyncio
from dataclasses import replace
from functools import partial
from typing import Any, Literal

import structlog

from service.errors import WorkerFailedError
from service.workers.base import PackedFrameJob
from service.workers.child_process import Program, WorkerLostError
from service.workers.device_process import DeviceProcess
from service.workers.fair_queue import SEEN, FairQueue
from service.workers.interpreter import Interpreter
from service.workers.placement import Placement
from service.workers.process import WorkerProcess
from service.workers.room import cores as cores_of_this_process
from service.workers.sleepers import Prepare, Sleepers
from service.workers.spare import Spare

log = structlog.get_logger(__name__)
Batching = Literal["auto", "on", "off"]
"""Whether workers of this machine share a device: ``auto`` a GPU, ``on`` any."""
REST_S = 300.0  # without a job, after which a worker that was woken sleeps again


class ProcessTransport:
    """Tracking processes among which sessions are spread, and one beside them for models and overlays.

    Each is shared between tenants by time (``service.workers.fair_queue``). Preparing a large mesh takes seconds; on
    a process of its own it holds up no frame. One more is kept ready, for whichever is lost.
    """

    def __init__(
        self,
        program: Program,
        workers: int,
        timeout_s: float,
        batching: Batching = "off",
        cores: int | None = None,
        first: Interpreter | None = None,
        awake: int | None = None,
        rest_s: float = REST_S,
    ) -> None:
        """``cores`` that the workers may use together; None: all. ``first`` becomes the first worker.

        ``awake`` of the workers are there from the start, the others when there is work for them; None: all.
        With batching the address of the device's owner is one more argument of the program's factory.
        """
        self._device: DeviceProcess | None = None
        if batching != "off" and workers > 1:
            self._device = DeviceProcess(batching == "on", program.nice)
            program = replace(program, arguments=(*program.arguments, self._device.address))
        awake = workers if awake is None else awake
        cores = cores or cores_of_this_process()
        shared = replace(program, threads=max(1, cores // awake))
        self._spare = Spare(shared)
        names = [*(f"track-{n}" for n in range(workers)), "side"]
        *self.workers, self.side = [
            WorkerProcess(name, shared, timeout_s, self._spare, first if name == names[0] else None) for name in names
        ]
        self._by_name = {worker.name: worker for worker in self.workers}
        self._placement = Placement(names[:awake])
        self._sleepers = Sleepers({n: self._by_name[n] for n in names[awake:workers]}, self._placement, rest_s)
        self._queues = {name: FairQueue(SEEN) for name in self._by_name}
        self._starts: set[asyncio.Task[None]] = set()

    @property
    def _awake(self) -> list[WorkerProcess]:
        return [worker for worker in self.workers if worker.name not in self._sleepers.asleep]

    def prestart(self) -> None:
        """Begin to bring the tracking processes up, beside whatever else the program does to start."""
        if self._device is not None:
            self._device.start()
        for worker in self._awake:
            worker.prestart()

    @property
    def ready(self) -> bool:
        """Whether every tracking process is up that does not sleep."""
        return all(worker.ready for worker in self._awake)

    @property
    def places(self) -> int:
        """One process is beside the tracking."""
        return 1

    @property
    def restarts(self) -> int:
        """Losses so far, over all processes."""
        return sum(worker.restarts for worker in (*self.workers, self.side))

    def processes(self) -> list[dict[str, Any]]:
        """The worker processes, for operators."""
        found: list[dict[str, Any]] = [
            {"name": worker.name, "pid": worker.pid, "ready": worker.ready, "restarts": worker.restarts}
            for worker in (*self._awake, self.side)
        ]
        if self._device is not None and self._device.shared:
            found.append(self._device.describe())
        return found

    def on_wake(self, prepare: Prepare) -> None:
        """See ``Transport``."""
        self._sleepers.prepare = prepare

    async def start(self) -> None:
        """Bring the tracking processes up. A spare follows, which is the one beside them once that is needed."""
        if self._device is not None:
            self._device.start()
        await asyncio.gather(*(worker.start() for worker in self._awake))
        self._spare.fill()

    async def call(self, key: str | None, method: str, job: object) -> Any:
        """Run a job of session ``key``, or beside the tracking where it is None."""
        if key is None:
            return await self.side.call(method, job)
        try:
            return await self._run(key, method, job)
        except WorkerLostError:
            try:  # another worker, which may have the session's model prepared
                return await self._run(key, method, job)
            except WorkerLostError as loss:
                raise WorkerFailedError(f"two workers failed during {method}") from loss

    async def _run(self, key: str, method: str, job: object) -> Any:
        name = self._placement.take(key, model_of(job))
        self._sleepers.given(name)
        try:
            tenant = key.rpartition("/")[0]  # see ``service.store.scope``
            worker = self._by_name[name]
            return await self._queues[name].run(tenant, worker.start, partial(worker.call_once, method, job))
        except WorkerLostError:
            self._placement.forget(name)
            if len(self._placement.workers) > 1:
                self._placement.remove(name)
                self._starts.add(start := asyncio.create_task(self._start_again(name)))
                start.add_done_callback(self._starts.discard)
            raise
        finally:
            self._placement.done(name)
            self._sleepers.done(name)

    async def _start_again(self, name: str) -> None:
        """A lost worker takes jobs again once it is up; where it cannot be, its next job says so."""
        try:
            await self._by_name[name].start()
        except WorkerFailedError as error:
            log.warning("worker did not start again", worker=name, reason=str(error))
        self._placement.add(name)

    async def close(self) -> None:
        """Finish what is in hand and end every process."""
        await asyncio.gather(*self._starts, self._sleepers.close())
        await asyncio.gather(*(worker.close() for worker in (*self.workers, self.side)))
        await asyncio.to_thread(self._spare.close)
        if self._device is not None:
            await asyncio.to_thread(self._device.close)


def model_of(job: object) -> str | None:
    """The model that a job needs prepared; None for jobs that need none."""
    return job.job.model if isinstance(job, PackedFrameJob) else None

"""What sessions call: jobs in, reports out, over whichever transport. Brings missing blobs to the worker."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Awaitable, Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Any, Protocol, TypeVar

import structlog

from service.errors import MissingBlobError, SkyposeError, TooLargeError, WorkerFailedError
from service.imaging.split import SplitFrame
from service.inference.spin.basins import PassMotion
from service.workers.base import (
    BackgroundJob,
    BackgroundReport,
    FrameJob,
    MeshJob,
    ModelJob,
    ModelReport,
    MotionJob,
    OverlayJob,
    PackedFrameJob,
    PackedFrameReport,
    ReadyJob,
    RestoreJob,
    RestoreReport,
    SmoothJob,
    SmoothReport,
)
from service.workers.placement import KNOWN_MODELS
from service.workers.process import timed_out
from service.workers.sleepers import Prepare, Run
from service.workers.splitting import SplitJob
from service.workers.turns import Turns

log = structlog.get_logger(__name__)
R = TypeVar("R")

BlobSource = Callable[[str], Awaitable[bytes]]
"""Key -> bytes of a stored blob."""


class Transport(Protocol):
    """Carries a job to a worker and its report back."""

    @property
    def ready(self) -> bool:
        """Whether jobs can run at once."""

    @property
    def places(self) -> int:
        """How many jobs beside the tracking run at one time."""

    @property
    def restarts(self) -> int:
        """Workers lost so far."""

    def processes(self) -> Sequence[Mapping[str, Any]]:
        """The worker processes, for operators."""

    def prestart(self) -> None:
        """Begin to bring the workers up, without waiting."""

    def on_wake(self, prepare: Prepare) -> None:
        """What a worker that was not needed until now is to do before it takes jobs."""

    async def start(self) -> None:
        """Bring the workers up."""

    async def call(self, key: str | None, method: str, job: object) -> Any:
        """Run ``method`` of the worker that ``key`` is pinned to (None: beside the tracking)."""

    async def close(self) -> None:
        """Finish what is in hand and end the workers."""


class Engine:
    """The workers as coroutines. Work beside the tracking waits its tenant's turn."""

    def __init__(self, transport: Transport) -> None:
        self.transport = transport
        self._turns = Turns(lambda: transport.places)
        self._bodies: OrderedDict[str, tuple[ReadyJob, BlobSource]] = OrderedDict()  # that were tracked last
        transport.on_wake(self._prepare)

    async def prepare_model(self, tenant: str, job: ModelJob) -> ModelReport:
        """Load, check and describe a model file. Raises ``TooLargeError`` where that takes too long."""
        try:
            report: ModelReport = await self._beside(tenant, "prepare_model", job)
        except WorkerFailedError as error:
            if not timed_out(error):
                raise
            raise TooLargeError("preparing the model takes too long", field="file", **error.facts) from error
        return report

    async def learn_background(self, session_id: str, job: BackgroundJob) -> BackgroundReport:
        """Decode an image and add it to the session's background."""
        report: BackgroundReport = await self.transport.call(session_id, "learn_background", job)
        return report

    async def ready(self, session_id: str, job: ReadyJob, blobs: BlobSource) -> None:
        """Prepare what a session's frames will need, where they will be tracked."""

        async def run(brought: Mapping[str, bytes]) -> None:
            await self.transport.call(session_id, "ready", replace(job, blobs=brought))

        await _with_blobs(run, blobs)

    async def track(self, session_id: str, job: FrameJob, state: bytes | None, blobs: BlobSource) -> PackedFrameReport:
        """One frame: packed state in, packed state out."""
        self._bodies[job.model] = ReadyJob(job.config, job.model, job.file_type, job.articulation, None), blobs
        self._bodies.move_to_end(job.model)
        if len(self._bodies) > KNOWN_MODELS:
            self._bodies.popitem(last=False)

        async def run(brought: Mapping[str, bytes]) -> PackedFrameReport:
            packed = PackedFrameJob(replace(job, blobs=brought), state)
            report: PackedFrameReport = await self.transport.call(session_id, "track", packed)
            return report

        return await _with_blobs(run, blobs)

    async def overlay(self, tenant: str, job: OverlayJob, blobs: BlobSource) -> tuple[bytes, ...]:
        """PNGs of a frame as ``job.show`` asks, in its order."""

        async def run(brought: Mapping[str, bytes]) -> tuple[bytes, ...]:
            images: tuple[bytes, ...] = await self._beside(tenant, "overlay", replace(job, blobs=brought))
            return images

        return await _with_blobs(run, blobs)

    async def mesh(self, tenant: str, job: MeshJob, blobs: BlobSource) -> bytes:
        """GLB of a model's prepared mesh."""

        async def run(brought: Mapping[str, bytes]) -> bytes:
            data: bytes = await self._beside(tenant, "mesh", replace(job, blobs=brought))
            return data

        return await _with_blobs(run, blobs)

    async def split(self, tenant: str, job: SplitJob) -> Sequence[SplitFrame]:
        """Every frame of a stored file as a file of its own."""
        frames: Sequence[SplitFrame] = await self._beside(tenant, "split", job)
        return frames

    async def restore(self, tenant: str, job: RestoreJob) -> RestoreReport:
        """Check what a checkpoint brings."""
        report: RestoreReport = await self._beside(tenant, "restore", job)
        return report

    async def smooth(self, tenant: str, job: SmoothJob) -> SmoothReport:
        """A pass smoothed."""
        report: SmoothReport = await self._beside(tenant, "smooth", job)
        return report

    async def motion(self, tenant: str, job: MotionJob, blobs: BlobSource) -> PassMotion:
        """How the object turned over a pass."""

        async def run(brought: Mapping[str, bytes]) -> PassMotion:
            found: PassMotion = await self._beside(tenant, "motion", replace(job, blobs=brought))
            return found

        return await _with_blobs(run, blobs)

    async def describe(self) -> Mapping[str, Any]:
        """Devices, scorer and versions, as a worker sees them."""
        description: Mapping[str, Any] = await self._beside("", "describe", None)
        return description

    async def _prepare(self, run: Run) -> Iterable[str]:
        """Have a worker prepare the bodies that were tracked last: no frame that goes there has to wait for it."""
        prepared = []
        for job, blobs in [*self._bodies.values()]:
            try:
                await _with_blobs(partial(_readied, run, job), blobs)
            except SkyposeError as error:  # a frame will meet it, and tell it
                log.info("not prepared", error=error.detail)
            else:
                prepared.append(job.model)
        return prepared

    async def _beside(self, tenant: str, method: str, job: object) -> Any:
        return await self._turns.run(tenant, partial(self.transport.call, None, method, job))


async def _readied(run: Run, job: ReadyJob, brought: Mapping[str, bytes]) -> None:
    await run("ready", replace(job, blobs=brought))


async def _with_blobs(run: Callable[[Mapping[str, bytes]], Awaitable[R]], blobs: BlobSource) -> R:
    """Try without blobs first: a worker nearly always has them. Then bring what it asks for."""
    brought: dict[str, bytes] = {}
    while True:
        try:
            return await run(brought)
        except MissingBlobError as missing:
            wanted = [key for key in missing.keys if key not in brought]
            if not wanted:
                raise
            for key in wanted:
                brought[key] = await blobs(key)

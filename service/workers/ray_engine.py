"""Workers as Ray actors, on as many machines as the cluster has.

An actor that dies, or whose node does, takes only caches with it: a job brings its state and is run again elsewhere,
and what ran twice is stored once (the store's epoch and index see to that). Lost actors are replaced by new ones, not
restarted by Ray, so that a job never meets an actor that is not ready.
"""

from __future__ import annotations

import asyncio
import os
import pickle
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")  # before the import, which reads it
os.environ.setdefault("RAY_DEDUP_LOGS", "0")

import ray
import structlog
from ray.exceptions import RayError, RayTaskError

from service.errors import StoppingError, WorkerFailedError
from service.workers.placement import Placement
from service.workers.pool import model_of
from service.workers.ray_worker import RayWorker, WorkerPlan
from service.workers.sleepers import Prepare

log = structlog.get_logger(__name__)
MOST_TRIES = 4
MOST_FAILURES = 3
BY_REFERENCE_BYTES = 100 << 10  # longer messages go into the object store, once for all tries; Ray's own limit
ANSWER_S = 10.0  # beyond two times a job's timeout, after which an actor that says nothing is ended
FIRST_PAUSE_S, LONGEST_PAUSE_S = 0.5, 30.0  # between tries to have an actor


@dataclass(frozen=True)
class RayPlan:
    """The cluster, and what to take of it."""

    address: str  # of a cluster; empty: one on this machine, for as long as the service runs
    actors: int  # 0: one per GPU, without any one per ``cores``
    cores: int  # that each actor asks for
    start_timeout_s: float


@dataclass
class _Actor:
    name: str
    handle: Any
    facts: Mapping[str, Any]  # pid, host, node
    memory_bytes: int = 0
    failures: int = 0  # jobs in a row


class RayTransport:
    """Transport over actors. Used on one event loop."""

    def __init__(self, plan: RayPlan, worker: WorkerPlan) -> None:
        self.restarts = 0
        self._plan, self._worker = plan, worker
        self._actors: dict[str, _Actor] = {}  # those that are ready
        self._placement = Placement()
        self._changed = asyncio.Condition()
        self._gpus = 0
        self._keepers: list[asyncio.Task[None]] = []
        self._closing = False
        self._in_hand = 0

    @property
    def ready(self) -> bool:
        """Whether an actor takes jobs."""
        return bool(self._actors)

    @property
    def places(self) -> int:
        """Each actor has a process beside its tracking."""
        return max(1, len(self._actors))

    def processes(self) -> Sequence[Mapping[str, Any]]:
        """The actors, for operators."""
        return [self._describe(f"track-{n}") for n in range(len(self._keepers))]

    def prestart(self) -> None:
        """Nothing: Ray starts with the service."""

    def on_wake(self, prepare: Prepare) -> None:
        """No actor sleeps."""

    async def start(self) -> None:
        """Join the cluster and have the first actor ready; the others follow. Raises ``WorkerFailedError``."""
        await asyncio.to_thread(self._join)
        self._keepers = [asyncio.create_task(self._keep(f"track-{n}")) for n in range(self._count())]
        try:
            await asyncio.wait_for(self._some_ready(), self._plan.start_timeout_s)
        except TimeoutError as error:
            raise WorkerFailedError(f"no Ray actor is ready after {self._plan.start_timeout_s:g} s") from error

    async def call(self, key: str | None, method: str, job: object) -> Any:
        """Run a job of session ``key``; where its actor is lost, on another one."""
        if self._closing:
            raise StoppingError("the service is shutting down")
        message = await asyncio.to_thread(pickle.dumps, (key, method, job), 5)
        sent: Any = ray.put(message) if len(message) > BY_REFERENCE_BYTES else message
        self._in_hand += 1
        try:
            return await self._try(key, method, model_of(job), sent)
        finally:
            self._in_hand -= 1
            async with self._changed:
                self._changed.notify_all()

    async def close(self) -> None:
        """Finish what is in hand, end the actors, leave the cluster."""
        self._closing = True
        async with self._changed:
            await self._changed.wait_for(lambda: self._in_hand == 0)
        for keeper in self._keepers:
            keeper.cancel()
        await asyncio.gather(*self._keepers, return_exceptions=True)
        await asyncio.gather(*(self._dismiss(actor) for actor in self._actors.values()))
        self._actors.clear()
        await asyncio.to_thread(ray.shutdown)

    def _join(self) -> None:
        given: dict[str, Any] = (
            {"address": self._plan.address} if self._plan.address else {"address": "local", "include_dashboard": False}
        )
        try:
            ray.init(**given, log_to_driver=False, configure_logging=False, namespace="skypose")
        except (ConnectionError, RuntimeError, ValueError) as error:
            raise WorkerFailedError(f"Ray cannot be joined: {error}") from error
        self._gpus = int(_resources().get("GPU", 0))

    def _count(self) -> int:
        if self._plan.actors:
            return self._plan.actors
        return self._gpus or max(1, int(_resources().get("CPU", 1)) // self._plan.cores)

    async def _keep(self, name: str) -> None:
        """Have an actor, wait until it is lost, have another."""
        pause_s = FIRST_PAUSE_S
        while True:
            options = {"num_cpus": self._plan.cores, "num_gpus": 1 if self._gpus else 0, "max_restarts": 0}
            handle: Any = ray.remote(RayWorker).options(**options, max_concurrency=1000).remote(self._worker)
            try:
                facts = await handle.start.remote()
            except RayError as error:
                log.warning("worker actor did not start", worker=name, reason=_line(error))
                ray.kill(handle)
                await asyncio.sleep(pause_s)
                pause_s = min(2 * pause_s, LONGEST_PAUSE_S)
                continue
            except asyncio.CancelledError:
                ray.kill(handle)
                raise
            pause_s = FIRST_PAUSE_S
            actor = self._actors[name] = _Actor(name, handle, facts)
            self._placement.add(name)
            log.info("worker started", worker=name, **facts)
            async with self._changed:
                self._changed.notify_all()
            try:
                await handle.live.remote()
            except RayError as error:
                self._lose(actor, "no job", error)

    async def _some_ready(self) -> None:
        async with self._changed:
            await self._changed.wait_for(lambda: bool(self._actors))

    async def _try(self, key: str | None, method: str, model: str | None, sent: Any) -> Any:
        last: BaseException | None = None
        failed: _Actor | None = None
        for _ in range(MOST_TRIES):
            try:
                await asyncio.wait_for(self._some_ready(), self._plan.start_timeout_s)
            except TimeoutError as error:
                raise WorkerFailedError("no worker is left, and none could be had") from error
            actor = self._actors[self._placement.take(key, model, None if failed is None else failed.name)]
            try:
                answered = await asyncio.wait_for(actor.handle.call.remote(sent), self._patience_s())
            except RayTaskError as error:
                self._note_failure(actor, method, error)
                if failed is not None:
                    raise WorkerFailedError(f"two workers failed during {method}") from error
                failed = actor
                continue
            except (RayError, TimeoutError) as error:
                last = error
                self._lose(actor, method, error)
                continue
            finally:
                self._placement.done(actor.name)
            actor.failures = 0
            refusal, answer, actor.memory_bytes = pickle.loads(answered)
            self._placement.weigh(actor.name, actor.memory_bytes)
            if refusal is not None:
                raise refusal
            return answer
        raise WorkerFailedError(f"the worker was lost {MOST_TRIES} times during {method}") from last

    def _patience_s(self) -> float:
        return 2 * self._worker.timeout_s + ANSWER_S

    def _note_failure(self, actor: _Actor, method: str, error: RayTaskError) -> None:
        """The actor lives, but its processes died over a job: the job's fault, unless it goes on like that."""
        log.warning("worker actor failed", worker=actor.name, method=method, reason=_line(error))
        actor.failures += 1
        if actor.failures == MOST_FAILURES:
            self._lose(actor, method, error)

    def _lose(self, actor: _Actor, method: str, error: BaseException) -> None:
        """Take no more of its answers, and have it replaced. Jobs that it had at the same time come here too."""
        if self._actors.get(actor.name) is not actor:
            return
        self.restarts += 1
        log.warning("worker lost", worker=actor.name, method=method, reason=_line(error), pid=actor.facts["pid"])
        del self._actors[actor.name]
        self._placement.remove(actor.name)
        ray.kill(actor.handle)

    async def _dismiss(self, actor: _Actor) -> None:
        try:
            await asyncio.wait_for(actor.handle.close.remote(), ANSWER_S)
        except (RayError, TimeoutError) as error:
            log.info("worker was gone already", worker=actor.name, reason=_line(error))
        ray.kill(actor.handle)

    def _describe(self, name: str) -> dict[str, Any]:
        actor = self._actors.get(name)
        if actor is None:
            return {"name": name, "pid": None, "ready": False}
        load, sessions = self._placement.load(name), self._placement.sessions(name)
        facts = {**actor.facts, "memory_mb": actor.memory_bytes >> 20, "load": load, "sessions": sessions}
        return {"name": name, "ready": True, "actor": actor.handle._actor_id.hex(), **facts}


def _resources() -> dict[str, float]:
    found: dict[str, float] = ray.cluster_resources()  # type: ignore[no-untyped-call]
    return found


def _line(error: BaseException) -> str:
    """What Ray says last: the lines before are traces."""
    return str(error).strip().rpartition("\n")[2] or type(error).__name__

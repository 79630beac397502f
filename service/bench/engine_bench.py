"""Frames per second of many sessions over a transport: one by one, all at once, over several workers.

What is measured begins with a job and ends with its report: no HTTP, no database. Contestants take turns, round after
round, so that what else the machine does meets all of them; each figure is the median of its rounds.
"""

from __future__ import annotations

import asyncio
import hashlib
import os
import statistics
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Literal

import numpy as np
from rich.box import MARKDOWN
from rich.table import Table

from gpu.mesh import load_mesh
from service.inference.params import JointParams, SessionConfig
from service.sessions.config import effective
from service.simulate.folder import encode_png
from service.simulate.motion import Motion
from service.simulate.satellite import demo_satellite
from service.simulate.scenario import Scenario
from service.simulate.sequence import SimulatedPass
from service.workers.base import BackgroundJob, FrameJob, ModelJob, PackedFrameReport
from service.workers.child_process import Program
from service.workers.engine import Engine, Transport
from service.workers.limits import DecodeLimits
from service.workers.pool import Batching, ProcessTransport
from service.workers.process import TRACKER
from service.workers.tracker import Tracker

WARM_FRAMES = 4  # until the track is established
INTERVAL_S = 0.1
TIMEOUT_S = 120.0


@dataclass(frozen=True)
class EnginePlan:
    """What is measured."""

    sessions: int = 16
    particles: int = 500
    size_px: int = 256
    frames: int = 5  # of each session and round
    rounds: int = 3
    preset: Literal["balanced", "paper"] = "balanced"


@dataclass(frozen=True)
class Contestant:
    """A transport, and whether sessions wait for each other."""

    name: str
    workers: int
    transport: Callable[[], Transport]
    one_by_one: bool = False


@dataclass(frozen=True)
class EngineRow:
    """Of one contestant."""

    engine: str
    workers: int
    sessions: int
    particles: int
    size_px: int
    frames_per_s: float
    p50_ms: float  # of a frame, from its job to its report
    p99_ms: float
    rounds: tuple[float, ...]  # frames per second of each


class Traffic:
    """Sessions of the bundled satellite with their states, and the same frames for all of them."""

    def __init__(self, plan: EnginePlan) -> None:
        tracker = Tracker()
        model = demo_satellite()
        report = tracker.prepare_model(ModelJob(model, "glb"))
        motion = Motion(frames=WARM_FRAMES + plan.frames)
        scenario = Scenario("", size=(plan.size_px, plan.size_px), seed=4, motion=motion)
        simulated = SimulatedPass(load_mesh(model, "glb"), report.articulation, scenario)
        learned: bytes | None = None
        for image in simulated.backgrounds():
            job = BackgroundJob(SessionConfig(), encode_png(image), "image/png", learned)
            learned = tracker.learn_background(job).background
        tracker.close()
        assert learned is not None, "a scenario has background frames"
        self._blobs = {hashlib.sha256(data).hexdigest(): data for data in (model, learned)}
        self._frames = [encode_png(image) for image in simulated.frames()]
        self._articulation, self._twins, self._plan = report.articulation, report.twins, plan
        self.states: list[bytes | None] = [None] * plan.sessions
        self.scorers: set[str] = set()

    async def blob(self, key: str) -> bytes:
        """What a worker asks for."""
        return self._blobs[key]

    def job(self, session: int, index: int) -> FrameJob:
        """A frame of a session."""
        config = effective({"filter": {"preset": self._plan.preset, "particles": self._plan.particles}})
        config = replace(config, filter=replace(config.filter, seed=session), joints=JointParams(free="all"))
        model, background = self._blobs
        where = config, model, "glb", self._articulation, background, None, index, INTERVAL_S * index
        return FrameJob(*where, self._frames[index], "image/png", twins=self._twins)

    async def track(self, engine: Engine, session: int, index: int, states: list[bytes | None]) -> float:
        """Seconds from a frame's job to its report."""
        began = time.perf_counter()
        job, state = self.job(session, index), states[session]
        report: PackedFrameReport = await engine.track(f"session-{session}", job, state, self.blob)
        states[session] = report.state
        self.scorers.add(report.scorer)
        return time.perf_counter() - began

    async def warm_up(self, engine: Engine) -> None:
        """Every session to the frame at which each round begins."""
        for index in range(WARM_FRAMES):
            await asyncio.gather(*(self.track(engine, n, index, self.states) for n in range(self._plan.sessions)))

    async def round(self, engine: Engine, one_by_one: bool) -> tuple[float, list[float], list[bytes | None]]:
        """Frames per second, seconds of each frame, the states afterwards."""
        states, sessions = list(self.states), range(self._plan.sessions)
        indices = range(WARM_FRAMES, WARM_FRAMES + self._plan.frames)
        began = time.perf_counter()
        if one_by_one:
            times = [await self.track(engine, n, index, states) for index in indices for n in sessions]
        else:
            found = await asyncio.gather(*(self._run(engine, n, states) for n in sessions))
            times = [seconds for of_one in found for seconds in of_one]
        return len(times) / (time.perf_counter() - began), times, states

    async def _run(self, engine: Engine, session: int, states: list[bytes | None]) -> list[float]:
        indices = range(WARM_FRAMES, WARM_FRAMES + self._plan.frames)
        return [await self.track(engine, session, index, states) for index in indices]


async def bench_engines(
    contestants: Sequence[Contestant], plan: EnginePlan, tell: Callable[[str], None]
) -> list[EngineRow]:
    """A row for each. Raises ``AssertionError`` unless all give every session the same state, bit for bit."""
    traffic = Traffic(plan)
    engines = {one: Engine(one.transport()) for one in contestants}
    rates: dict[Contestant, list[float]] = {one: [] for one in engines}
    times: dict[Contestant, list[float]] = {one: [] for one in engines}
    expected: list[bytes | None] | None = None
    try:
        for one in contestants:
            await engines[one].transport.start()
            tell(f"{one.name}: warming up")
            await traffic.warm_up(engines[one])
        for number in range(plan.rounds):
            for one in contestants:
                # Every worker must have seen the model; the first round of all is thrown away for that.
                rate, seconds, states = await traffic.round(engines[one], one.one_by_one)
                expected = expected or states
                assert states == expected, f"{one.name} gives other answers"
                if number > 0:
                    rates[one].append(rate)
                    times[one] += seconds
            tell(f"round {number} of {plan.rounds - 1}")
    finally:
        for engine in engines.values():
            await engine.transport.close()
    return [_row(one, plan, rates[one], times[one]) for one in contestants]


def process_contestants(workers: Sequence[int]) -> list[Contestant]:
    """One worker with one session after the other, and each number of workers with all of them at once."""

    def processes(count: int, batching: Batching) -> ProcessTransport:
        program = Program(TRACKER, (DecodeLimits(), None), start_timeout_s=TIMEOUT_S)
        return ProcessTransport(program, count, TIMEOUT_S, batching)

    at_once = [Contestant("processes", n, partial(processes, n, "off")) for n in workers]
    batched = [Contestant("batching", n, partial(processes, n, "on")) for n in workers if n > 1]
    return [Contestant("one by one", 1, partial(processes, 1, "off"), one_by_one=True), *at_once, *batched]


def ray_contestant() -> Contestant:
    """An actor of one process, on a Ray of its own on this machine: one by one, so that what Ray adds is seen."""
    from service.workers.ray_engine import RayPlan, RayTransport
    from service.workers.ray_worker import WorkerPlan

    program = Program(TRACKER, (DecodeLimits(), None), start_timeout_s=TIMEOUT_S)
    cores = len(os.sched_getaffinity(0))  # as many as the one worker process of the first contestant
    worker = WorkerPlan(program, 1, TIMEOUT_S, "off", cores)
    return Contestant("ray, one by one", 1, lambda: RayTransport(RayPlan("", 1, 1, TIMEOUT_S), worker), one_by_one=True)


def engines_table(rows: Sequence[EngineRow]) -> Table:
    """A line per engine."""
    table = Table(title="sessions at once", title_justify="left", box=MARKDOWN)
    table.add_column("engine", no_wrap=True)
    for name in ("workers", "sessions", "particles", "px", "frames/s", "to the first", "p50 ms", "p99 ms"):
        table.add_column(name, justify="right", no_wrap=True)
    for row in rows:
        counts = str(row.workers), str(row.sessions), f"{row.particles:,}", str(row.size_px)
        ratio = f"{row.frames_per_s / rows[0].frames_per_s:.2f}"
        table.add_row(row.engine, *counts, f"{row.frames_per_s:.1f}", ratio, f"{row.p50_ms:.0f}", f"{row.p99_ms:.0f}")
    return table


def _row(one: Contestant, plan: EnginePlan, rates: Sequence[float], seconds: Sequence[float]) -> EngineRow:
    p50, p99 = (round(1e3 * float(np.percentile(seconds, q)), 2) for q in (50, 99))
    rate = round(statistics.median(rates), 2)
    kept = tuple(round(r, 2) for r in rates)
    return EngineRow(one.name, one.workers, plan.sessions, plan.particles, plan.size_px, rate, p50, p99, kept)

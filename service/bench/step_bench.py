"""A whole step of the filter, from resampling to the estimate: how long, how much of it is scoring, how much memory."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field
from functools import partial
from typing import Literal, Protocol

import numpy as np

from gpu.bench import Contestant, contestants, told_absent
from gpu.mesh import Mesh
from gpu.scorer import BACKENDS, Scorer
from service.bench.peak_memory import peak_mib
from service.bench.step_device import ResidentStep
from service.bench.step_scene import INTERVAL_S, StepScene, step_scene
from service.inference.params import (
    FilterParams,
    MotionParams,
    SessionConfig,
    preset_defaults,
)
from service.inference.state import Frame, Measurement
from service.inference.step import step
from service.workers.following import stream_of
from service.workers.resident import ResidentSteps
from service.workers.scoring import TimedScorer

Where = Literal["host", "device"]

COMPARED = ("outline", "opengl", "cpu-mt", "cpu")


@dataclass(frozen=True)
class StepPlan:
    """What is measured, and how long."""

    particles: tuple[int, ...] = (1_000, 10_000, 100_000)
    size_px: int = 512
    repeats: int = 7
    longest_s: float = 5.0  # a step that would take longer is left out
    seed: int = 0


QUICK = StepPlan(repeats=3, longest_s=3.0)


@dataclass(frozen=True)
class StepRow:
    """Medians over the repeats. ``step`` says what was run, ``score_share`` is the scorer's share of the time."""

    backend: str
    step: str
    particles: int
    size_px: int
    faces: int
    step_ms: float
    score_ms: float
    score_share: float
    peak_mib: float | None  # largest resident size of the process during a step; None where the system does not say
    device: str


@dataclass
class StepFigures:
    """Rows, and what was left out and why."""

    rows: list[StepRow] = field(default_factory=list)
    absent: dict[str, str] = field(default_factory=dict)


class StepRunner(Protocol):
    """A filter that carries its own state from frame to frame."""

    device: str

    def run(self, frame: int) -> float:
        """One step; seconds of it that the scorer took."""


RunnerOf = Callable[[Scorer, StepScene, int, int], StepRunner]


@dataclass(frozen=True)
class StepContestant:
    """A way to make a step, with the scorer that it uses; ``make`` takes scorer, scene, particles and seed."""

    name: str
    scorer: Contestant
    make: RunnerOf

    @property
    def title(self) -> str:
        """Both in one."""
        return f"{self.scorer.name}, {self.name}"


class SessionStep:
    """``service.inference.step`` as a session of the preset `paper` runs it: state in, state and estimate out."""

    def __init__(self, where: Where, scorer: Scorer, scene: StepScene, particles: int, seed: int) -> None:
        self.device = scorer.name
        self._scorer, self._scene, self._seed = scorer, scene, seed
        self._config = config_of(particles, where)
        self._resident = ResidentSteps(1).of(scorer, self._config, scene.domain)
        # From the whole prior it would take long to find the pose.
        self._state = scene.near_truth(np.random.default_rng(seed), particles, self._config)

    def run(self, frame: int) -> float:
        """See ``StepRunner``."""
        rng = stream_of(self._seed, frame)
        seen = Frame(frame, frame * INTERVAL_S, Measurement(self._scene.log_ratio, 0.0))
        timed = TimedScorer(self._scorer, self._scene.articulation, self._scene.log_ratio)
        self._state, _ = step(rng, self._state, seen, timed, self._config, self._scene.domain, bootstrap=self._resident)
        return timed.seconds if self._resident is None else self._resident.seconds


def step_contestants(backends: Sequence[str] = ()) -> list[StepContestant]:
    """Every step with each of these scorers; by default with the fastest one, and the paper's with the others too.

    Raises ``ScorerError`` for an unknown scorer.
    """
    offered = contestants(backends or [name for name in COMPARED if name in BACKENDS])
    return [
        StepContestant(name, scorer, make)
        for scorer in offered
        for name, make in (
            ("paper, host", partial(SessionStep, "host")),
            ("paper, device", partial(SessionStep, "device")),
            ("paper, resident", _resident),
        )
        if backends or scorer.name == COMPARED[0] or name == "paper, host"
    ]


def _resident(scorer: Scorer, scene: StepScene, particles: int, seed: int) -> StepRunner:
    return ResidentStep(config_of(particles, "device"), scorer, scene, particles, seed)


def config_of(particles: int, where: Where = "host") -> SessionConfig:
    """The preset `paper` with so many particles."""
    given = preset_defaults("paper")
    return SessionConfig(
        filter=FilterParams(**{**given["filter"], "particles": particles, "step": where}),
        motion=MotionParams(**given["motion"]),
    )


def bench_step(
    entries: Sequence[StepContestant], mesh: Mesh, plan: StepPlan, tell: Callable[[str], None] = lambda line: None
) -> StepFigures:
    """Measure all contestants at every number of particles; they take turns, step by step."""
    figures = StepFigures()
    scene = step_scene(mesh, plan.size_px, plan.seed)
    with ExitStack() as stack:
        opened: dict[str, Scorer] = {}
        for scorer in {entry.scorer.name: entry.scorer for entry in entries}.values():
            with told_absent(figures.absent, scorer.name):
                opened[scorer.name] = scorer.open(mesh)
                stack.callback(opened[scorer.name].close)
        left = [entry for entry in entries if entry.scorer.name in opened]
        for particles in plan.particles:
            tell(f"{particles:,} particles")
            left = _affordable(left, figures, particles, plan)
            _measure(left, opened, scene, particles, figures, plan)
    return figures


def _affordable(
    entries: Sequence[StepContestant], figures: StepFigures, particles: int, plan: StepPlan
) -> list[StepContestant]:
    """Those whose step, by what a smaller one took, stays within ``plan.longest_s``."""
    kept = []
    for entry in entries:
        smaller = [row for row in figures.rows if (row.backend, row.step) == (entry.scorer.name, entry.name)]
        expected_s = 1e-3 * smaller[-1].step_ms * particles / smaller[-1].particles if smaller else 0.0
        if expected_s > plan.longest_s:
            figures.absent[entry.title] = f"{particles:,} particles would take about {expected_s:.0f} s a step"
        else:
            kept.append(entry)
    return kept


def _timed(runner: StepRunner, frame: int) -> tuple[float, float]:
    """Seconds of a step, and of its scoring."""
    began = time.perf_counter()
    scoring_s = runner.run(frame)
    return time.perf_counter() - began, scoring_s


def _measure(
    entries: Sequence[StepContestant],
    opened: dict[str, Scorer],
    scene: StepScene,
    particles: int,
    figures: StepFigures,
    plan: StepPlan,
) -> None:
    runners: dict[str, StepRunner] = {}
    for entry in entries:
        with told_absent(figures.absent, entry.title):
            runners[entry.title] = entry.make(opened[entry.scorer.name], scene, particles, plan.seed)
            runners[entry.title].run(1)
    times: dict[str, list[tuple[float, float]]] = {title: [] for title in runners}
    for repeat in range(plan.repeats):
        for title, runner in runners.items():
            if title not in figures.absent:
                with told_absent(figures.absent, title):
                    times[title].append(_timed(runner, 2 + repeat))
    devices = {title: runner.device for title, runner in runners.items()}
    runners.clear()  # so that each one's memory is measured by itself
    for entry in entries:
        taken = times.get(entry.title, [])
        if entry.title in figures.absent or not taken:
            continue
        step_s, score_s = np.median(taken, axis=0)
        figures.rows.append(
            StepRow(
                backend=entry.scorer.name,
                step=entry.name,
                particles=particles,
                size_px=plan.size_px,
                faces=scene.mesh.n_faces,
                step_ms=1e3 * float(step_s),
                score_ms=1e3 * float(score_s),
                score_share=float(np.median([scored / whole for whole, scored in taken])),
                peak_mib=_peak(entry, opened[entry.scorer.name], scene, particles, plan.seed),
                device=devices[entry.title],
            )
        )


def _peak(entry: StepContestant, scorer: Scorer, scene: StepScene, particles: int, seed: int) -> float | None:
    runner = entry.make(scorer, scene, particles, seed)
    runner.run(1)
    return peak_mib(lambda: runner.run(2))

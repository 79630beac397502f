"""The default update: predict or acquire, temper, and know whether the image supports the result."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from service.inference.acquisition import find_evidence, place
from service.inference.domain import Domain
from service.inference.motion import carry_on, diffusion, propagate
from service.inference.params import SessionConfig
from service.inference.pose import local
from service.inference.resample import RESAMPLERS
from service.inference.state import Array, FilterState, Measurement, Poses
from service.inference.tempering import Population, Tempering, temper

ScoreMaps = Callable[[Poses, NDArray[np.float32]], Array]

ESTABLISHED_FRAMES = 3  # frames of support in a row before a track is called one
SUPPORT_LOST = 0.35  # share of the frame's light that the best silhouette must explain
SUPPORT_DROP = 0.6  # of the track's own usual support: below it, the whole space is searched again
RATE_GAIN = 0.5


class FrameLike(Protocol):
    """What this module needs of a frame."""

    @property
    def index(self) -> int:
        """Index in the session."""

    @property
    def time_s(self) -> float:
        """Time of the frame."""

    @property
    def measurement(self) -> Measurement:
        """Its measurement."""


@dataclass(frozen=True)
class Outcome:
    """The posterior after a frame."""

    poses: Poses
    log_weights: Array
    log_likelihood: Array
    rates: Array
    status: str
    log_evidence: float
    memory: Mapping[str, NDArray[np.generic]]


def tempered_update(
    rng: np.random.Generator,
    state: FilterState | None,
    frame: FrameLike,
    score_maps: ScoreMaps,
    config: SessionConfig,
    domain: Domain,
    joint_radius: Array,
) -> Outcome:
    """One frame of the default filter."""
    log_ratio = frame.measurement.log_ratio
    light = float(np.sum(np.maximum(log_ratio, 0.0)))

    stack = log_ratio[None]  # one array, so that the scorer knows it again

    def score(poses: Poses) -> Array:
        return score_maps(poses, stack)[:, 0]

    def run(population: Population, deviation: Array, moves: int) -> tuple[Population, float]:
        plan = Tempering(
            config.likelihood.exponent,
            config.filter.target_ess,
            moves,
            config.filter.resampler,
            deviation,
            joint_radius,
        )
        result, log_evidence, _ = temper(rng, population, score, domain.contains, plan, config.filter.particles)
        return result, log_evidence

    tracked: tuple[Population, float] | None = None
    usual = 0.0
    if state is not None and state.status in ("acquiring", "tracking"):
        population, deviation = predict(rng, state, frame, score, config, domain)
        tracked = run(population, deviation, config.filter.moves)
        usual = float(np.asarray(state.memory.get("support", 0.0)))
        if support(tracked[0], light) < max(SUPPORT_LOST, SUPPORT_DROP * usual):
            tracked = None
    if tracked is None:
        evidence = find_evidence(log_ratio)
        if evidence is None:
            return nothing_seen(rng, state, frame, config, domain)
        poses = place(rng, domain, evidence, score_maps, config.filter.acquisition_particles)
        start = Population(poses, score(poses), None, np.zeros((len(poses), domain.n_tangent)))
        tracked = run(start, widest_move(domain), config.filter.acquisition_moves)
    population, log_evidence = tracked
    return conclude(state, frame, population, log_evidence, light, usual, domain)


def widest_move(domain: Domain) -> Array:
    """(6 + J,) greatest standard deviation of a move while the whole space is searched."""
    side = min(domain.width, domain.height)
    least, greatest = domain.joint_bounds
    return np.array([0.4, 0.4, 0.4, 0.05 * side, 0.05 * side, 0.15, *(0.1 * (greatest - least))])


def predict(
    rng: np.random.Generator,
    state: FilterState,
    frame: FrameLike,
    score: Callable[[Poses], Array],
    config: SessionConfig,
    domain: Domain,
) -> tuple[Population, Array]:
    """Resample at the head of the step, carry on by the rates, and spread by the motion's diffusion."""
    ancestors = RESAMPLERS[config.filter.resampler](rng, state.log_weights, config.filter.particles)
    before, rates = state.poses[ancestors], state.rates[ancestors]
    dt_s = max(frame.time_s - state.time_s, 1e-3)
    if config.motion.kind == "jitter":
        rates = np.zeros_like(rates)
    centre = carry_on(before, rates, dt_s)
    deviation = diffusion(config.motion, domain) * np.sqrt(dt_s)
    poses = propagate(rng, centre, deviation)
    inside = domain.contains(poses)
    log_likelihood = np.where(inside, score(poses), -1e6)
    return Population(poses, log_likelihood, centre, rates), deviation


def support(population: Population, light: float) -> float:
    """Share of the frame's light (sum of the map's positive part) that the best silhouette explains."""
    return float(np.max(population.log_likelihood)) / max(light, 1e-9)


def nothing_seen(
    rng: np.random.Generator, state: FilterState | None, frame: FrameLike, config: SessionConfig, domain: Domain
) -> Outcome:
    """No light at all: the posterior is the prediction, or the placement on the image's centre."""
    raise NotImplementedError


def conclude(
    state: FilterState | None,
    frame: FrameLike,
    population: Population,
    log_evidence: float,
    light: float,
    usual: float,
    domain: Domain,
) -> Outcome:
    """Rates, status and memory after the frame."""
    n = len(population.log_likelihood)
    rates = population.rates
    if population.centre is not None and state is not None:
        dt_s = max(frame.time_s - state.time_s, 1e-3)
        innovation = local(population.centre, population.poses).mean(axis=0)
        rates = rates + RATE_GAIN * innovation / dt_s
    fit = support(population, light)
    age = int(np.asarray(state.memory.get("age", 0))) + 1 if state is not None and population.centre is not None else 1
    status = "tracking" if age >= ESTABLISHED_FRAMES else "acquiring"
    return Outcome(
        domain.wrap(population.poses),
        np.full(n, -np.log(n)),
        population.log_likelihood,
        rates,
        status,
        log_evidence,
        {
            "age": np.array(age),
            "support": np.array(fit if usual == 0 else 0.8 * usual + 0.2 * fit),
        },
    )

"""The default update: predict or acquire, temper, and know whether the image supports the result."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from service.inference.acquisition import Evidence, find_evidence, place
from service.inference.domain import Domain
from service.inference.islands import refine, repeat, scatter, strongest
from service.inference.modes import distance, metric_of
from service.inference.motion import RateFilter, carry_on, propagate, rate_filter
from service.inference.params import SessionConfig
from service.inference.pose import local
from service.inference.resample import RESAMPLERS
from service.inference.state import Array, FilterState, Frame, Outcome, Poses
from service.inference.symmetry import Symmetry, fold
from service.inference.tempering import Population, Tempering, join, temper

ScoreMaps = Callable[[Poses, NDArray[np.float32]], Array]

ESTABLISHED_FRAMES = 3  # frames of support in a row before a track is called one
SUPPORT_FLOOR = 0.3  # share of the frame's light that the best silhouette must explain
SUPPORT_DROP = 0.6  # of the track's own usual support; below it the whole space is searched again
MOST_SURPRISE = 3.0
FADE = 0.85  # of the running averages, per frame
SHARPEN_PARTICLES = 100
SEARCH_STAGES = ((64, 4, 24), (16, 5, 40), (6, 6, 60))  # islands, rounds, draws per round
IN_PLAY_NATS = 12.0  # a basin whose peak lies further below the best, after the exponent, gets no particles
CLOUD = 0.25  # of the search's reach: how far a basin's particles are strewn about its peak
NEWCOMER = 0.1  # prior share of what a renewed search finds beside a track


@dataclass(frozen=True)
class Update:
    """What the parts of one frame's update share."""

    rng: np.random.Generator
    state: FilterState | None
    frame: Frame
    score_maps: ScoreMaps
    config: SessionConfig
    domain: Domain
    twins: Sequence[Symmetry]

    @cached_property
    def maps(self) -> NDArray[np.float32]:
        """(1, H, W): one array, so that the scorer knows it again."""
        return self.frame.measurement.log_ratio[None]

    @cached_property
    def light(self) -> float:
        """Sum of the map's positive part: what a silhouette could explain at most."""
        return float(np.sum(np.maximum(self.frame.measurement.log_ratio, 0.0)))

    @property
    def dt_s(self) -> float:
        """Time since the last frame."""
        return 1e-3 if self.state is None else max(self.frame.time_s - self.state.time_s, 1e-3)

    def score(self, poses: Poses) -> Array:
        """(N,) the particle term of Eq. 4."""
        return self.score_maps(poses, self.maps)[:, 0]

    def recall(self, name: str, otherwise: Array | float) -> Array:
        """Something remembered from earlier frames."""
        if self.state is None or name not in self.state.memory:
            return np.asarray(otherwise, dtype=np.float64)
        return np.asarray(self.state.memory[name], dtype=np.float64)

    @cached_property
    def rate_filter(self) -> RateFilter:
        """What earlier frames tell of the rates."""
        known = None
        if self.state is not None and "rate_variance" in self.state.memory:
            known = self.recall("rate_variance", 0.0)
        return rate_filter(self.config.motion, self.domain, known)

    @property
    def surprise(self) -> float:
        """How much further than predicted the poses have been lately, 1 or more: the prediction widens with it."""
        return float(np.clip(np.sqrt(self.recall("surprise", 1.0)), 1.0, MOST_SURPRISE))

    def plan(self, deviation: Array, moves: int) -> Tempering:
        """How to approach this frame's likelihood."""
        chosen = self.config.filter
        metric = metric_of(self.domain.articulation)
        exponent = self.config.likelihood.exponent
        return Tempering(exponent, chosen.target_ess, moves, chosen.resampler, deviation, metric)


def tempered_update(
    rng: np.random.Generator,
    state: FilterState | None,
    frame: Frame,
    score_maps: ScoreMaps,
    config: SessionConfig,
    domain: Domain,
    twins: Sequence[Symmetry] = (),
) -> Outcome:
    """One frame of the default filter.

    Follows the track where there is one. Searches the whole space where there is none, where it is not yet
    established, or where the image does not support it any more; what the search finds stands beside the track
    with the weight that the likelihoods give it.
    """
    update = Update(rng, state, frame, score_maps, config, domain, twins)
    evidence = find_evidence(frame.measurement.log_ratio)
    if evidence is None:
        return unseen(update)
    known = update.recall("age", 0.0) > 0
    established = state is not None and state.status == "tracking"
    found = follow(update) if known else None
    if found is None or not established or not supported(update, found[0]):
        searched = search(update, evidence)
        found = searched if found is None else side_by_side(update, found, searched)
    if float(np.max(found[0].log_likelihood)) <= 0.0:
        return unseen(update)
    return conclude(update, *found)


def follow(update: Update) -> tuple[Population, float]:
    """Resample at the head of the step, carry on by the rates, spread by the motion's diffusion, temper."""
    state, config, domain = update.state, update.config, update.domain
    assert state is not None, "there is a track to follow"
    ancestors = RESAMPLERS[config.filter.resampler](update.rng, state.log_weights, config.filter.particles)
    rates = state.rates[ancestors]
    centre = domain.wrap(carry_on(state.poses[ancestors], rates, update.dt_s))
    deviation = np.sqrt(update.rate_filter.prediction_variance(update.dt_s)) * update.surprise
    poses = propagate(update.rng, centre, deviation)  # joints stay in the chart of their prediction
    log_likelihood = np.where(domain.contains(poses), update.score(poses), -update.light)
    population = Population(poses, log_likelihood, centre, rates)
    plan = update.plan(deviation, config.filter.moves)
    population, log_evidence, _ = temper(
        update.rng, population, update.score, domain.contains, plan, config.filter.particles
    )
    return population, log_evidence


def search(update: Update, evidence: Evidence) -> tuple[Population, float]:
    """The whole space: rotations and joints placed on the evidence, the most promising refined on their own.

    What comes out are the basins whose peaks the frame's likelihood leaves in play, each with its share of the
    particles, tempered together at last.
    """
    config, domain = update.config, update.domain
    metric = metric_of(domain.articulation)
    starts = config.filter.acquisition_particles
    poses = place(update.rng, domain, evidence, update.score_maps, starts)
    reach = search_reach(domain)
    islands = scatter(poses, update.score(poses), metric, SEARCH_STAGES[0][0], reach)
    for count, rounds, draws in SEARCH_STAGES:
        islands = strongest(islands, metric, count)
        islands = refine(update.rng, islands, update.score, domain.contains, rounds, draws)
    top = int(np.argmax(islands.log_likelihood))
    one, _ = fold(
        islands.best, np.zeros((len(islands), domain.n_tangent)), update.twins, domain, islands.best[top : top + 1]
    )
    islands = strongest(replace(islands, best=one), metric, len(islands))
    exponent = config.likelihood.exponent
    in_play = np.flatnonzero(exponent * (islands.log_likelihood - islands.log_likelihood.max()) > -IN_PLAY_NATS)
    share = -(-config.filter.particles // len(in_play))
    deviation = CLOUD * reach
    cloud = propagate(update.rng, repeat(islands[in_play].best, share), deviation)
    log_likelihood = np.where(domain.contains(cloud), update.score(cloud), -update.light)
    start = Population(cloud, log_likelihood, None, np.zeros((len(cloud), domain.n_tangent)))
    plan = update.plan(widest_move(domain), config.filter.acquisition_moves)
    population, log_evidence, _ = temper(
        update.rng, start, update.score, domain.contains, plan, config.filter.particles
    )
    return population, log_evidence


def search_reach(domain: Domain) -> Array:
    """(6 + J,) standard deviation with which an island starts: about the distance between placed starts."""
    least, greatest = domain.joint_bounds
    side = 0.012 * min(domain.width, domain.height)
    return np.array([0.12, 0.12, 0.12, side, side, 0.08, *(0.06 * (greatest - least))])


def widest_move(domain: Domain) -> Array:
    """(6 + J,) greatest standard deviation of a move while the whole space is searched."""
    side = min(domain.width, domain.height)
    least, greatest = domain.joint_bounds
    return np.array([0.4, 0.4, 0.4, 0.05 * side, 0.05 * side, 0.15, *(0.1 * (greatest - least))])


def supported(update: Update, population: Population) -> bool:
    """Whether the best silhouette explains as much of the light as it should, and as it used to."""
    usual = float(update.recall("support", 0.0))
    return support(update, population) >= max(SUPPORT_FLOOR, SUPPORT_DROP * usual)


def support(update: Update, population: Population) -> float:
    """Share of the frame's light that the best silhouette explains, less what it covers in vain."""
    return float(np.max(population.log_likelihood)) / max(update.light, 1e-9)


def side_by_side(
    update: Update, tracked: tuple[Population, float], searched: tuple[Population, float]
) -> tuple[Population, float]:
    """The track, and what a search has found elsewhere, weighted by the likelihoods of their best silhouettes."""
    old = tracked[0]
    top = int(np.argmax(old.log_likelihood))
    best = old.poses[top : top + 1]
    poses, rates = fold(searched[0].poses, searched[0].rates, update.twins, update.domain, best)
    new = replace(searched[0], poses=poses, rates=rates)
    elsewhere = np.flatnonzero(distance(new.poses, best, metric_of(update.domain.articulation)) > 1.0)
    if len(elsewhere) == 0:
        return tracked
    exponent = update.config.likelihood.exponent
    gain = exponent * (float(np.max(new.log_likelihood[elsewhere])) - float(old.log_likelihood[top]))
    share = NEWCOMER * len(elsewhere) / len(new.log_likelihood) * np.exp(np.minimum(gain, 50.0))
    share = share / (share + 1.0 - NEWCOMER)
    weights = np.concatenate(
        [
            np.full(len(old.log_likelihood), (1 - share) / len(old.log_likelihood)),
            np.full(len(elsewhere), share / len(elsewhere)),
        ]
    )
    both = join(old, new[elsewhere])
    pick = RESAMPLERS["systematic"](update.rng, np.log(np.maximum(weights, 1e-300)), len(old.log_likelihood))
    return both[pick], tracked[1]


def surprise(update: Update, shift: Array) -> float:
    """Mean square shift of the whole population from its predictions, in units of the predicted variance.

    A quarter of it is to be expected, since the frame's own weight decides only in part.
    """
    variance = update.rate_filter.prediction_variance(update.dt_s)
    return 4.0 * float(np.mean(np.mean(shift, axis=0)[:3] ** 2 / variance[:3]))


def sharpen(update: Update, population: Population, deviation: Array) -> tuple[Poses, float]:
    """The pose of highest likelihood near the best particle: a small population tempered on to the full exponent."""
    metric = metric_of(update.domain.articulation)
    top = int(np.argmax(population.log_likelihood))
    near = np.flatnonzero(distance(population.poses, population.poses[top : top + 1], metric) <= 1.0)
    few = near[np.argsort(-population.log_likelihood[near])[:SHARPEN_PARTICLES]]
    start = replace(population[few], centre=None)
    plan = replace(update.plan(deviation, 3), exponent=1.0, start=update.config.likelihood.exponent)
    sharp, _, _ = temper(update.rng, start, update.score, update.domain.contains, plan, SHARPEN_PARTICLES)
    best = int(np.argmax(sharp.log_likelihood))
    return update.domain.wrap(sharp.poses[best : best + 1]), float(sharp.log_likelihood[best])


def unseen(update: Update) -> Outcome:
    """No object in the image: the posterior is the prediction, which widens until it is seen again."""
    state, domain, config = update.state, update.domain, update.config
    count = config.filter.particles
    if state is not None and update.recall("age", 0.0) > 0:
        rates = state.rates
        centre = domain.wrap(carry_on(state.poses, rates, update.dt_s))
        moved = propagate(update.rng, centre, np.sqrt(update.rate_filter.prediction_variance(update.dt_s)))
        poses = Poses(
            moved.quaternion,
            np.clip(moved.position, 0, (domain.width, domain.height)),
            state.poses.log_scale,
            moved.joints,
        )
        memory: Mapping[str, NDArray[np.generic]] = state.memory
        log_weights = state.log_weights
    else:
        nowhere = Evidence(0.25 * domain.width * domain.height, 0.5 * np.array([domain.width, domain.height]), 1.0)
        poses = place(update.rng, domain, nowhere, update.score_maps, count)
        rates, memory = np.zeros((count, domain.n_tangent)), {}
        log_weights = np.full(count, -np.log(count))
    log_likelihood = update.score(domain.wrap(poses))
    return Outcome(domain.wrap(poses), log_weights, log_likelihood, rates, "no_target", 0.0, memory)


def conclude(update: Update, population: Population, log_evidence: float) -> Outcome:
    """Rates, status and memory after the frame."""
    n = len(population.log_likelihood)
    poses, rates = update.domain.wrap(population.poses), population.rates
    memory = {} if update.state is None else dict(update.state.memory)
    if population.centre is not None:
        shift = local(population.centre, population.poses)
        rates, learned = update.rate_filter.update(rates, shift, update.dt_s)
        memory["rate_variance"] = learned.variance
        memory["surprise"] = np.array(FADE * update.recall("surprise", 1.0) + (1 - FADE) * surprise(update, shift))
    else:
        memory.pop("rate_variance", None)
        memory.pop("surprise", None)
    fit = support(update, population)
    usual = float(update.recall("support", fit))
    lost = fit < SUPPORT_FLOOR
    age = 0.0 if lost else float(update.recall("age", 0.0)) + 1
    memory["age"] = np.array(age)
    memory["support"] = np.array(FADE * usual + (1 - FADE) * fit)
    status = "lost" if lost else "tracking" if age >= ESTABLISHED_FRAMES else "acquiring"
    best = sharpen(update, population, widest_move(update.domain))
    return Outcome(poses, np.full(n, -np.log(n)), population.log_likelihood, rates, status, log_evidence, memory, best)

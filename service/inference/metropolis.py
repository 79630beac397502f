"""The method `tempered`: the frame's likelihood approached by resampling and Metropolis moves."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from service.inference.domain import Domain
from service.inference.islands import Islands, repeat
from service.inference.mixture import Draws
from service.inference.motion import carry_on, propagate
from service.inference.pose import local
from service.inference.resample import RESAMPLERS
from service.inference.search import search_reach
from service.inference.state import Array
from service.inference.tempering import Population, Tempering, temper
from service.inference.update import Update

CLOUD = 0.25  # of the search's reach: how far a basin's particles are strewn about its peak
FADE = 0.85  # of the running average of the surprise


def follow_by_moves(update: Update) -> Draws:
    """Resample at the head of the step, carry on by the rates, spread by the motion's diffusion, temper."""
    state, chosen = update.state, update.config.filter
    assert state is not None, "there is a track to follow"
    ancestors = RESAMPLERS[chosen.resampler](update.rng, state.log_weights, chosen.particles)
    rates = state.rates[ancestors]
    centre = update.domain.wrap(carry_on(state.poses[ancestors], rates, update.dt_s))
    deviation = np.sqrt(update.rates.prediction_variance(update.dt_s)) * update.surprise
    poses = propagate(update.rng, centre, deviation)  # joints stay in the chart of their prediction
    population = Population(poses, update.score(poses), centre, rates)
    population, log_evidence = run(update, population, deviation, chosen.moves)
    assert population.centre is not None, "it came from a prediction"
    shift = local(population.centre, population.poses)
    rates, learned = update.rates.update(population.rates, shift, update.dt_s)
    # A quarter of the predicted variance is to be expected, since the frame's own weight decides only in part.
    seen = 4.0 * float(np.mean(np.mean(shift, axis=0)[:3] ** 2 / deviation[:3] ** 2))
    surprise = FADE * update.recall("surprise", 1.0) + (1 - FADE) * seen
    memory = {"rate_variance": learned.variance, "surprise": np.asarray(surprise)}
    return even(population, rates, log_evidence, memory)


def strew(update: Update, islands: Islands) -> Draws:
    """Particles strewn about the islands' peaks, tempered together."""
    count = update.config.filter.particles
    share = -(-count // len(islands))
    cloud = propagate(update.rng, repeat(islands.best, share), CLOUD * search_reach(update.domain))
    rates = np.zeros((len(cloud), update.domain.n_tangent))
    start = Population(cloud, update.score(cloud), None, rates)
    population, log_evidence = run(update, start, widest_move(update.domain), update.config.filter.acquisition_moves)
    return even(population, population.rates, log_evidence, {})


def run(update: Update, population: Population, deviation: Array, moves: int) -> tuple[Population, float]:
    """Temper a population onto this frame's likelihood."""
    chosen = update.config.filter
    exponent = update.exponent()
    plan = Tempering(exponent, chosen.target_ess, moves, chosen.resampler, deviation, update.metric)
    result, log_evidence, _ = temper(
        update.rng, population, update.score, update.domain.contains, plan, chosen.particles
    )
    return result, log_evidence


def even(population: Population, rates: Array, log_evidence: float, memory: Mapping[str, NDArray[np.generic]]) -> Draws:
    """Equally weighted particles whose weights sum to the evidence."""
    n = len(population.log_likelihood)
    log_weights = np.full(n, log_evidence - np.log(n))
    return Draws(population.poses, rates, population.log_likelihood, log_weights, memory)


def widest_move(domain: Domain) -> Array:
    """(6 + J,) greatest standard deviation of a move while the whole space is searched."""
    side = min(domain.width, domain.height)
    least, greatest = domain.joint_bounds
    return np.array([0.4, 0.4, 0.4, 0.05 * side, 0.05 * side, 0.15, *(0.1 * (greatest - least))])

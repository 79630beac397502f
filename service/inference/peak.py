"""The pose of highest likelihood near the particles, and which of a body's twins has it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from service.inference.islands import Islands, refine
from service.inference.mixture import Draws
from service.inference.modes import distance, short_way
from service.inference.pose import local
from service.inference.state import Poses
from service.inference.symmetry import Symmetry, twin, twin_rates
from service.inference.update import Update
from service.inference.weights import normalise

SHARPEN_ROUNDS, SHARPEN_DRAWS = 8, 24
BEST_FIT_ROUNDS, BEST_FIT_DRAWS = 10, 40
TWIN_NATS = 1.0  # by which another twin must explain the frame better before the filter changes sides


def sharpen(update: Update, draws: Draws) -> tuple[Poses, float]:
    """The pose of highest likelihood near the best particle: a cross-entropy search from there."""
    return _climb(update, draws, 0.25, SHARPEN_ROUNDS, SHARPEN_DRAWS)


def likeliest_twin(update: Update, draws: Draws) -> Draws:
    """The particles, or those twins of them whose best fit explains the frame best.

    Real bodies are symmetric but for a door or an antenna. Twins then fit alike, yet the wrong one fits best a little
    beside the truth, so it matters which of them is followed.
    """
    if not update.twins:
        return draws
    exponent = update.config.likelihood.exponent
    sides = [draws, *(_through(update, draws, symmetry) for symmetry in update.twins)]
    peaks = np.array([_climb(update, side, 1.0, BEST_FIT_ROUNDS, BEST_FIT_DRAWS)[1] for side in sides])
    top = int(np.argmax(peaks))
    return sides[top] if exponent * (peaks[top] - peaks[0]) > TWIN_NATS else draws


def _through(update: Update, draws: Draws, symmetry: Symmetry) -> Draws:
    """The twins of the particles, weighed by what the frame says of them."""
    poses = update.domain.wrap(twin(draws.poses, symmetry))
    log_likelihood = update.score(poses)
    gain = update.config.likelihood.exponent * (log_likelihood - draws.log_likelihood)
    rates = twin_rates(draws.rates, symmetry)
    return replace(draws, poses=poses, rates=rates, log_likelihood=log_likelihood, log_weights=draws.log_weights + gain)


def _climb(update: Update, draws: Draws, widen: float, rounds: int, per_round: int) -> tuple[Poses, float]:
    """A cross-entropy search from the best particle, ``widen`` times as wide as those around it have variance."""
    top = int(np.argmax(draws.log_likelihood))
    best = draws.poses[top : top + 1]
    near = np.flatnonzero(distance(draws.poses, best, update.metric) <= 1.0)
    weights = np.exp(normalise(draws.log_weights[near])[0])
    x = short_way(local(best, draws.poses[near]), update.metric)
    x = x - weights @ x
    covariance = widen * np.einsum("n,ni,nj->ij", weights, x, x) + 1e-8 * np.eye(x.shape[1])
    start = Islands(best, draws.log_likelihood[top : top + 1], best, covariance[None])
    peak = refine(update.rng, start, update.score, update.domain.contains, rounds, per_round)
    return update.domain.wrap(peak.best), float(peak.log_likelihood[0])

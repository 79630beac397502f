"""The pose of highest likelihood near the particles, and which of a body's twins has it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from service.inference.islands import Islands, refine
from service.inference.mixture import Draws
from service.inference.modes import cluster, distance, short_way
from service.inference.motion import carry_on
from service.inference.pose import concatenate, local, retract
from service.inference.slope import sloped
from service.inference.state import Array, Poses
from service.inference.symmetry import Symmetry, twin, twin_rates
from service.inference.update import Update
from service.inference.weights import normalise

Memory = Mapping[str, NDArray[np.generic]]

BEST_FIT_ROUNDS, BEST_FIT_DRAWS = 10, 40
LEAST_SHARE = 0.1  # of the posterior, that a mode must hold to be preferred for its continuity
TWIN_NATS = 1.0  # by which another twin must explain the frame better before the filter changes sides


def best_pose(update: Update, draws: Draws) -> tuple[Poses, float]:
    """The best particle of the preferred mode, or that mode's mean where it explains the frame better.

    The particles lie as far apart as the likelihood's power in ``Update.exponent`` leaves them, so their mean is mostly
    nearer to the peak than the best of them.
    """
    metric = update.metric
    value = draws.log_likelihood + sloped(draws.slopes, draws.poses, metric)
    top = int(np.argmax(np.where(_preferred(update, draws), value, -np.inf)))
    best, weights, x = _around(update, draws, top)
    mean = update.domain.wrap(retract(best, weights[None] @ x))
    log_likelihood = float(update.score(mean)[0])
    if log_likelihood + float(sloped(draws.slopes, mean, metric)[0]) < value[top]:
        return update.domain.wrap(best), float(draws.log_likelihood[top])
    return mean, log_likelihood


def likeliest_twin(update: Update, draws: Draws) -> Draws:
    """The particles, or those twins of them whose best fit explains the frame best.

    Real bodies are symmetric but for a door or an antenna. Twins then fit alike, yet the wrong one fits best a little
    beside the truth, so it matters which of them is followed.
    """
    if not update.twins:
        return draws
    exponent = update.config.likelihood.mode_exponent
    sides = [draws, *(_through(update, draws, symmetry) for symmetry in update.twins)]
    tops = [int(np.argmax(side.log_likelihood)) for side in sides]
    fits = [_climb(update, side, top) for side, top in zip(sides, tops, strict=True)]
    peaks = np.array([log_likelihood for _, log_likelihood in fits])
    peaks += update.shading(concatenate(*(pose for pose, _ in fits)))
    top = int(np.argmax(peaks))
    return sides[top] if exponent * (peaks[top] - peaks[0]) > TWIN_NATS else draws


def _through(update: Update, draws: Draws, symmetry: Symmetry) -> Draws:
    """The twins of the particles, weighed by what the frame says of them."""
    poses = update.domain.wrap(twin(draws.poses, symmetry))
    log_likelihood = update.score(poses)
    gain = update.exponent() * (log_likelihood - draws.log_likelihood)
    rates = twin_rates(draws.rates, symmetry)
    log_weights = draws.log_weights + gain
    # The slopes of this side say nothing of the other.
    return replace(draws, poses=poses, rates=rates, log_likelihood=log_likelihood, log_weights=log_weights, slopes=())


def heading(update: Update, draws: Draws, best: Poses) -> Memory:
    """What the next frame must know to prefer the mode that goes on where ``best`` was going."""
    if update.config.filter.prefer != "continuity":
        return {}
    near, weights = _mode_at(update, draws, best)
    return {
        "heading_quaternion": best.quaternion,
        "heading_position": best.position,
        "heading_log_scale": best.log_scale,
        "heading_joints": best.joints,
        "heading_rate": weights @ draws.rates[near],
    }


def _preferred(update: Update, draws: Draws) -> NDArray[np.bool_]:
    """(N,) particles of the mode that ``best`` is to be taken from."""
    everybody = np.ones(len(draws.poses), dtype=bool)
    rule = update.config.filter.prefer
    if rule == "likelihood":
        return everybody
    labels = cluster(draws.poses, draws.log_likelihood, update.metric)
    share = np.bincount(labels, weights=np.exp(normalise(draws.log_weights)[0]))
    heaviest = np.asarray(labels == int(np.argmax(share)))
    if rule == "weight" or update.state is None or "heading_rate" not in update.state.memory:
        return heaviest
    names = ("quaternion", "position", "log_scale", "joints")
    last = Poses(*(update.recall(f"heading_{name}", 0.0) for name in names))
    expected = carry_on(last, update.recall("heading_rate", 0.0)[None], update.dt_s)
    gap = np.where(share[labels] >= LEAST_SHARE, distance(draws.poses, expected, update.metric), np.inf)
    nearest = int(np.argmin(gap))
    return np.asarray(labels == labels[nearest]) if gap[nearest] <= 1.0 else heaviest


def _mode_at(update: Update, draws: Draws, pose: Poses) -> tuple[NDArray[np.intp], Array]:
    """The particles (n,) of the mode at one pose, and their weights, which sum to 1."""
    near = np.flatnonzero(distance(draws.poses, pose, update.metric) <= 1.0)
    return near, np.exp(normalise(draws.log_weights[near])[0])


def _around(update: Update, draws: Draws, top: int) -> tuple[Poses, Array, Array]:
    """Particle ``top``; weights (n,) and tangent coordinates (n, d) of those in its mode."""
    best = draws.poses[top : top + 1]
    near, weights = _mode_at(update, draws, best)
    return best, weights, short_way(local(best, draws.poses[near]), update.metric)


def _climb(update: Update, draws: Draws, top: int) -> tuple[Poses, float]:
    """A cross-entropy search from particle ``top``, as wide as those around it."""
    best, weights, x = _around(update, draws, top)
    x = x - weights @ x
    covariance = np.einsum("n,ni,nj->ij", weights, x, x) + 1e-8 * np.eye(x.shape[1])
    start = Islands(best, update.score(best), best, covariance[None], np.zeros(1))
    peak = refine(update.rng, start, update.score, update.domain.contains, BEST_FIT_ROUNDS, BEST_FIT_DRAWS)
    return update.domain.wrap(peak.best), float(peak.log_likelihood[0])

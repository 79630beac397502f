"""Many local searches at once: each promising start is refined on its own, none competes before it has been.

A cross-entropy search with a rank-weighted covariance update (Rubinstein 1999; Hansen 2016 for the weights) per
island, all islands scored in one batch. Tempering alone would let the first rounds, where every start is still far
from its peak, decide which basin survives.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from service.inference.modes import Metric, distance
from service.inference.pose import retract
from service.inference.state import Array, Poses

Score = Callable[[Poses], Array]

_ELITE = 0.25  # share of an island's draws that its next round learns from
_KEEP = 0.5  # weight of the old covariance


@dataclass(frozen=True)
class Islands:
    """K local searches: the best pose of each, and where it draws from next."""

    best: Poses  # (K)
    log_likelihood: Array  # (K,) of ``best``
    mean: Poses  # (K)
    covariance: Array  # (K, d, d) tangent space at ``mean``
    shading: Array  # (K,) nats by which light and shade speak for ``best``, as far as they were looked at

    @property
    def rank(self) -> Array:
        """(K,) what speaks for each."""
        return self.log_likelihood + self.shading

    def __len__(self) -> int:
        return len(self.log_likelihood)

    def __getitem__(self, index: NDArray[np.intp]) -> Islands:
        return Islands(
            self.best[index], self.log_likelihood[index], self.mean[index], self.covariance[index], self.shading[index]
        )


def scatter(poses: Poses, log_likelihood: Array, metric: Metric, count: int, deviation: Array) -> Islands:
    """Open at most ``count`` islands at the best poses that are at least one cluster radius apart."""
    order = np.argsort(-log_likelihood)[: 40 * count]
    ranked = poses[order]
    free = np.ones(len(order), dtype=bool)
    chosen: list[int] = []
    while len(chosen) < count and free.any():
        k = int(np.argmax(free))
        chosen.append(k)
        free &= distance(ranked, ranked[k : k + 1], metric) > 1.0
    picked = order[np.array(chosen, dtype=np.intp)]
    seeds = poses[picked]
    return Islands(
        seeds, log_likelihood[picked], seeds, np.tile(np.diag(deviation**2), (len(picked), 1, 1)), np.zeros(len(picked))
    )


def refine(
    rng: np.random.Generator,
    islands: Islands,
    score: Score,
    inside: Callable[[Poses], NDArray[np.bool_]],
    rounds: int,
    draws: int,
) -> Islands:
    """Run ``rounds`` of ``draws`` poses on every island."""
    k, d = len(islands), islands.covariance.shape[1]
    n_elite = max(3, round(_ELITE * draws))
    ranks = np.log(n_elite + 0.5) - np.log(np.arange(1, n_elite + 1))
    weights = ranks / ranks.sum()
    best, best_score = islands.best, islands.log_likelihood
    mean, covariance = islands.mean, islands.covariance
    for _ in range(rounds):
        factor = np.linalg.cholesky(covariance + 1e-12 * np.eye(d))
        step = np.einsum("kij,kmj->kmi", factor, rng.standard_normal((k, draws, d)))
        poses = retract(repeat(mean, draws), step.reshape(-1, d))
        scores = np.where(inside(poses), score(poses), -np.inf).reshape(k, draws)
        top = np.argsort(-scores, axis=1)[:, :n_elite]
        elite = np.take_along_axis(step, top[:, :, None], axis=1)  # (K, E, d)
        first = np.arange(k) * draws + top[:, 0]
        better = scores.ravel()[first] > best_score
        best = pick(better, poses[first], best)
        best_score = np.where(better, scores.ravel()[first], best_score)
        mean = retract(mean, np.einsum("e,kei->ki", weights, elite))
        covariance = _KEEP * covariance + (1 - _KEEP) * np.einsum("e,kei,kej->kij", weights, elite, elite)
    return Islands(best, best_score, mean, covariance, np.zeros(k))


def repeat(poses: Poses, count: int) -> Poses:
    """Each of K poses ``count`` times, in a row: K * count poses."""
    return Poses(
        *(np.repeat(a, count, axis=0) for a in (poses.quaternion, poses.position, poses.log_scale, poses.joints))
    )


def pick(condition: NDArray[np.bool_], a: Poses, b: Poses) -> Poses:
    """Per particle: ``a`` where the condition holds, else ``b``."""
    c = condition[:, None]
    return Poses(
        np.where(c, a.quaternion, b.quaternion),
        np.where(c, a.position, b.position),
        np.where(condition, a.log_scale, b.log_scale),
        np.where(c, a.joints, b.joints),
    )


def strongest(islands: Islands, metric: Metric, count: int) -> Islands:
    """The ``count`` best islands, one per basin: those that have run into a better one are left out."""
    order = np.argsort(-islands.rank)
    kept: list[int] = []
    for k in order:
        near = kept and np.min(distance(islands.best[np.array(kept)], islands.best[k : k + 1], metric)) < 0.3
        if not near:
            kept.append(int(k))
        if len(kept) == count:
            break
    return islands[np.array(kept, dtype=np.intp)]

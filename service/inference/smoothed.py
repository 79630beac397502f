"""What is reported of a smoothed frame: the same figures as of a filtered one, out of Gaussians."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from service.inference.belief import Belief, rates_of
from service.inference.domain import Domain
from service.inference.estimate import mean_pose, report, spread, twin_modes
from service.inference.pose import concatenate, repeat, retract
from service.inference.revolution import turned_round
from service.inference.state import Array, Mode, PoseEstimate, Poses, Rates, Spread
from service.inference.symmetry import Symmetry, twin


@dataclass(frozen=True)
class SmoothedEstimate:
    """A frame's marginal given the whole pass. ``best`` is the mean of the heaviest mode."""

    mean: PoseEstimate
    best: PoseEstimate
    spread: Spread  # within the mode of ``best``
    spread_all: Spread  # over all modes and twins, about ``mean``
    modes: tuple[Mode, ...]
    rates: Rates | None


def summarise_belief(belief: Belief, twins: Sequence[Symmetry], domain: Domain, with_rates: bool) -> SmoothedEstimate:
    """Mean, spreads and modes over all twins; rates of the heaviest mode where the motion has any."""
    weights = np.exp(belief.log_weights)
    axes = domain.articulation.round_axes
    clouds = [_everybody(turned_round(sigma_points(belief, k), axes), twins, domain) for k in range(len(belief))]
    each = len(clouds[0][0])  # points of one mode
    even = np.full(each, 1.0 / each)
    modes = [
        mode for cloud, w in zip(clouds, weights, strict=True) for mode in twin_modes(cloud, even, float(w), domain)
    ]
    poses = concatenate(*(poses for cloud in clouds for poses in cloud))
    n_alike = len(twins) + 1
    shared = np.repeat(weights, each * n_alike) / (each * n_alike)
    mean = domain.wrap(mean_pose(poses, shared, domain.wrapping))
    top = int(np.argmax(weights))
    best, rates = report(belief.poses[np.array([top])]), rates_of(belief, top) if with_rates else None
    if rates is not None:
        best = replace(best, rotation_rate=rates.velocity[:3])
    return SmoothedEstimate(
        mean=report(mean),
        best=best,
        spread=spread(clouds[top][0], even, belief.poses[np.array([top])], domain.wrapping),
        spread_all=spread(poses, shared, mean, domain.wrapping),
        modes=tuple(sorted(modes, key=lambda mode: -mode.weight)),
        rates=rates,
    )


def sigma_points(belief: Belief, k: int) -> Poses:
    """2 d poses of equal weight with the mean and the covariance of mode ``k`` (Julier, Uhlmann 1997)."""
    d = belief.n_tangent
    values, vectors = np.linalg.eigh(belief.covariance[k, :d, :d])
    axes: Array = (vectors * np.sqrt(d * np.maximum(values, 0.0))).T
    return retract(repeat(belief.poses[np.array([k])], 2 * d), np.concatenate([axes, -axes]))


def _everybody(poses: Poses, twins: Sequence[Symmetry], domain: Domain) -> list[Poses]:
    return [domain.wrap(poses), *(domain.wrap(twin(poses, symmetry)) for symmetry in twins)]

"""A frame's weighted particles as a sum of Gaussians over poses and rates: what is kept of them for good."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from service.inference.domain import Domain
from service.inference.estimate import mean_pose, tangent
from service.inference.model.prior import POSE_DEGREES_OF_FREEDOM
from service.inference.modes import LEAST_MODE, MOST_MODES, cluster, distance, metric_of
from service.inference.pose import concatenate
from service.inference.state import Array, FilterState, Mixture, Poses, Rates
from service.inference.weights import second_moment


@dataclass(frozen=True)
class Belief:
    """K modes, one of each set of twins; d = 6 + J. Rates are tangent velocities per second."""

    time_s: float
    widening: float  # the next prediction's noise is this many times the motion's: 1, but in earlier versions
    log_weights: Array  # (K,) of weights that sum to 1
    poses: Poses  # (K) means
    rates: Array  # (K, d) means
    covariance: Array  # (K, 2d, 2d) of (pose in the tangent space of its mean, rates)
    each: bool = False  # whether symmetry-equivalents are modes of their own; not in earlier versions

    def __len__(self) -> int:
        return len(self.log_weights)

    @property
    def n_tangent(self) -> int:
        """d = 6 + J."""
        return int(self.rates.shape[1])


def belief_of(state: FilterState, domain: Domain) -> Belief | None:
    """The modes of a particle set, heaviest first; None where it holds nothing but the prior."""
    if state.status == "no_target":
        return None
    weights = np.exp(state.log_weights)
    labels = cluster(state.poses, state.log_weights, metric_of(domain.articulation))
    share = np.bincount(labels, weights=weights)
    heaviest = [int(k) for k in np.argsort(-share)[:MOST_MODES] if share[k] >= LEAST_MODE]
    means, rate_means, covariances = [], [], []
    for k in heaviest:
        members = np.flatnonzero(labels == k)
        inner = weights[members] / share[k]
        mean = domain.wrap(mean_pose(state.poses[members], inner, domain.wrapping))
        rate = inner @ state.rates[members]
        x = np.hstack([tangent(mean, state.poses[members], domain.wrapping), state.rates[members] - rate])
        covariance = second_moment(inner, x)
        means.append(mean)
        rate_means.append(rate)
        covariances.append(covariance)
    return Belief(
        time_s=state.time_s,
        widening=1.0,
        log_weights=np.log(share[heaviest] / share[heaviest].sum()),
        poses=concatenate(*means),
        rates=np.array(rate_means),
        covariance=np.array(covariances),
        each=True,
    )


def belief_of_mixture(state: FilterState, mixture: Mixture) -> Belief:
    """The modes of a filter that keeps modes."""
    covariance = np.stack([covariance_of(mixture, k) for k in range(len(mixture.poses))])
    return Belief(state.time_s, 1.0, mixture.log_weights, mixture.poses, mixture.rates, covariance, each=True)


def covariance_of(mixture: Mixture, k: int) -> Array:
    """(2d, 2d) covariance of a mode's pose and rates: a Student t's is wider than its scale."""
    degrees = POSE_DEGREES_OF_FREEDOM
    return np.asarray(degrees / (degrees - 2) * mixture.covariance[k])


def rates_near(belief: Belief, pose: Poses, domain: Domain) -> Rates:
    """Rates of the mode that is nearest to ``pose`` (a batch of one)."""
    return rates_of(belief, int(np.argmin(distance(belief.poses, pose, metric_of(domain.articulation)))))


def rates_of(belief: Belief, k: int) -> Rates:
    """Rates of mode ``k`` with their standard deviations."""
    variance = np.diag(belief.covariance[k])[belief.n_tangent :]
    return Rates(belief.rates[k], np.sqrt(np.maximum(variance, 0.0)))

"""A mixture as it is told: particles drawn from it, mean (Eq. 5), modes and spreads."""

from __future__ import annotations

import numpy as np

from service.inference.belief import covariance_of
from service.inference.domain import Domain, sample_prior
from service.inference.estimate import mean_pose, report, spread
from service.inference.model.prior import POSE_DEGREES_OF_FREEDOM
from service.inference.numerics.student import draw, root_of
from service.inference.pose import concatenate, retract
from service.inference.state import Array, Estimate, FilterState, Goodness, Mixture, Mode, Poses, Spread

_DRAWS = 1000  # numerical: for the spreads that have no closed form: yaw, pitch, roll


def drawn(rng: np.random.Generator, mixture: Mixture, count: int, domain: Domain) -> tuple[Poses, Array]:
    """``count`` particles of equal weight and their rates (count, d): each mode has its share of them."""
    share = np.exp(mixture.log_weights)
    edges = np.concatenate([[0.0], np.cumsum(share / share.sum())])
    edges[-1] = 1.0
    numbers = np.diff(np.floor(edges * count + rng.random()).astype(int))  # systematic: none is off by more than one
    numbers[np.argmax(share)] += count - numbers.sum()
    poses, rates = [], []
    for k, n in enumerate(numbers):
        if not n:
            continue
        d = mixture.rates.shape[1]
        steps = draw(rng, mixture.covariance[k], POSE_DEGREES_OF_FREEDOM, int(n))
        moved = retract(mixture.poses[np.full(n, k)], steps[:, :d])
        low, high = domain.joint_bounds
        joints = np.where(domain.wrapping, moved.joints, np.clip(moved.joints, low, high))
        log_scale = np.clip(moved.log_scale, *domain.log_scale_bounds)
        poses.append(domain.wrap(Poses(moved.quaternion, moved.position, log_scale, joints)))
        rates.append(mixture.rates[k] + steps[:, d:])
    return concatenate(*poses), np.concatenate(rates)


def mode_spread(rng: np.random.Generator, mixture: Mixture, k: int, domain: Domain) -> Spread:
    """Standard deviations and covariance of one mode."""
    d = mixture.rates.shape[1]
    covariance = covariance_of(mixture, k)[:d, :d]
    mean = mixture.poses[k : k + 1]
    steps = rng.standard_normal((_DRAWS, d)) @ root_of(covariance).T
    steps[:, 3:] = 0.0  # only turns are looked at; a scale that nothing is known of would overflow
    found = spread(
        retract(mean[np.zeros(_DRAWS, dtype=np.intp)], steps), np.full(_DRAWS, 1 / _DRAWS), mean, domain.wrapping
    )
    units = np.ones(d)
    units[:3] = np.rad2deg(1.0)
    told = covariance * np.outer(units, units)
    deviation = np.sqrt(np.diag(told))
    return Spread(
        orientation_deg=float(np.sqrt(np.trace(told[:3, :3]))),
        yaw_deg=found.yaw_deg,
        pitch_deg=found.pitch_deg,
        roll_deg=found.roll_deg,
        x_px=float(deviation[3]),
        y_px=float(deviation[4]),
        scale_px=float(deviation[5] * np.exp(mean.log_scale[0])),
        joints=deviation[6:],
        covariance=told,
    )


def estimate_of(
    rng: np.random.Generator,
    mixture: Mixture,
    particles: Poses,
    status: str,
    domain: Domain,
    probabilities: Array,
    evidence: tuple[float, float],
    fit: Goodness | None,
) -> Estimate:
    """What a frame's answer holds. ``evidence``: log evidence of the best mode's frame, and of the body's."""
    count = len(particles)
    weights = np.full(count, 1 / count)
    mean = domain.wrap(mean_pose(particles, weights, domain.wrapping))
    modes = []
    for k in np.argsort(-mixture.log_weights):
        width = mode_spread(rng, mixture, int(k), domain)
        modes.append(Mode(float(np.exp(mixture.log_weights[k])), report(domain.wrap(mixture.poses[k : k + 1])), width))
    return Estimate(
        status=status,
        mean=report(mean),
        best=modes[0].pose,
        best_log_likelihood=evidence[0],
        spread=modes[0].spread,
        modes=tuple(modes),
        n_particles=count,
        ess=float(count),
        log_evidence=evidence[1],
        spread_all=spread(particles, weights, mean, domain.wrapping),
        probabilities=probabilities,
        fit=fit,
    )


def unseen(
    rng: np.random.Generator, domain: Domain, count: int, index: int, time_s: float
) -> tuple[FilterState, Estimate]:
    """No light, and no mode to look for it at: nothing is known but the prior."""
    poses = sample_prior(rng, domain, count)
    weights, none = np.full(count, 1 / count), np.zeros((count, domain.n_tangent))
    mean = domain.wrap(mean_pose(poses, weights, domain.wrapping))
    wide = spread(poses, weights, mean, domain.wrapping)
    told = np.array([1.0, 0.0, 0.0])
    estimate = Estimate(
        status="no_target",
        mean=report(mean),
        best=report(mean),
        best_log_likelihood=0.0,
        spread=wide,
        modes=(Mode(1.0, report(mean), wide),),
        n_particles=count,
        ess=float(count),
        log_evidence=0.0,
        spread_all=wide,
        probabilities=told,
    )
    return FilterState(poses, np.log(weights), none, index, time_s, "no_target"), estimate

"""A mixture as it is told: particles drawn from it, mean (Eq. 5), modes and spreads."""

from __future__ import annotations

import functools
from collections.abc import Sequence

import numpy as np

from service.inference.belief import covariance_of
from service.inference.domain import Domain, sample_prior
from service.inference.estimate import mean_pose, report, spread
from service.inference.model.prior import POSE_DEGREES_OF_FREEDOM
from service.inference.numerics.student import draw, root_of
from service.inference.pose import concatenate, exp_so3, multiply, retract, yaw_pitch_roll_deg
from service.inference.revolution import Axis, turned_freely, with_free_turn
from service.inference.state import Array, Estimate, FilterState, Goodness, Mixture, Mode, Poses, Spread

_DRAWS = 128  # numerical: pairs, for the spreads that have no closed form: yaw, pitch, roll


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
        turned = turned_freely(rng, moved.quaternion, domain.articulation.round_axes)
        poses.append(domain.wrap(Poses(turned, moved.position, log_scale, joints)))
        rates.append(mixture.rates[k] + steps[:, d:])
    return concatenate(*poses), np.concatenate(rates)


def mode_spread(mixture: Mixture, k: int, axes: Sequence[Axis]) -> Spread:
    """Standard deviations and covariance of one mode of a body that is round about ``axes``."""
    d = mixture.rates.shape[1]
    covariance = with_free_turn(covariance_of(mixture, k)[:d, :d], axes)
    mean = mixture.poses[k : k + 1]
    yaw, pitch, roll = _euler_deviations(mean.quaternion, covariance[:3, :3])
    units = np.ones(d)
    units[:3] = np.rad2deg(1.0)
    told = covariance * np.outer(units, units)
    deviation = np.sqrt(np.diag(told))
    return Spread(
        orientation_deg=float(np.sqrt(np.trace(told[:3, :3]))),
        yaw_deg=yaw,
        pitch_deg=pitch,
        roll_deg=roll,
        x_px=float(deviation[3]),
        y_px=float(deviation[4]),
        scale_px=float(deviation[5] * np.exp(mean.log_scale[0])),
        joints=deviation[6:],
        covariance=told,
    )


def _euler_deviations(quaternion: Array, covariance: Array) -> list[float]:
    """Of yaw, pitch and roll, degrees, under turns of (3, 3) covariance (rad) of a batch of one."""
    turned = multiply(quaternion, exp_so3(_unit_draws() @ root_of(covariance).T))
    off = yaw_pitch_roll_deg(turned) - yaw_pitch_roll_deg(quaternion)
    off = np.mod(off + 180.0, 360.0) - 180.0
    return [float(one) for one in np.sqrt(np.mean(off**2, axis=0))]


@functools.cache
def _unit_draws() -> Array:
    """(2 N, 3) of the unit Gaussian, in pairs of opposites, with just its covariance."""
    half = np.random.default_rng(0).standard_normal((_DRAWS, 3))
    half = half @ np.linalg.inv(np.linalg.cholesky(half.T @ half / _DRAWS)).T
    return np.concatenate([half, -half])


def estimate_of(
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
        width = mode_spread(mixture, int(k), domain.articulation.round_axes)
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

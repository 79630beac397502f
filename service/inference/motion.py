"""Between frames: the jitter of the paper, and constant rates."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from service.inference.domain import Domain
from service.inference.params import MotionParams
from service.inference.pose import retract
from service.inference.state import Array, Poses


def diffusion(params: MotionParams, domain: Domain) -> Array:
    """(6 + J,) standard deviations of the tangent coordinates per square root of a second."""
    side = min(domain.width, domain.height)
    joints = [
        params.joint_deg if joint.kind == "revolute" else params.joint_range * (joint.maximum - joint.minimum)
        for joint in domain.articulation.joints
    ]
    rotation = np.deg2rad(params.rotation_deg)
    return np.array([rotation] * 3 + [params.position * side] * 2 + [params.log_scale, *joints])


def propagate(rng: np.random.Generator, poses: Poses, deviation: Array) -> Poses:
    """Random jitter (the paper's motion): a Gaussian step of ``deviation`` (6 + J,) in the tangent space."""
    return retract(poses, rng.standard_normal((len(poses), len(deviation))) * deviation)


def carry_on(poses: Poses, rates: Array, dt_s: float) -> Poses:
    """Constant rates: move each pose by its own rate (N, 6 + J) for ``dt_s``."""
    return retract(poses, rates * dt_s)


@dataclass(frozen=True)
class RateFilter:
    """What is known of the rates, given the path of a particle: a Kalman filter per tangent coordinate.

    A particle's path is taken as exact (Rao-Blackwellisation; Doucet, de Freitas, Murphy, Russell 2000): its rate v
    has a mean of its own and a variance V that all particles share, since it depends on times alone. Over dt a pose
    moves by v dt plus jitter of variance q dt, and the rate by a random step of variance r dt.
    """

    variance: Array  # (6 + J,) V, tangent units^2 / s^2
    jitter: Array  # (6 + J,) q, tangent units^2 / s
    change: Array  # (6 + J,) r, tangent units^2 / s^3

    def prediction_variance(self, dt_s: float) -> Array:
        """(6 + J,) variance of a pose after ``dt_s``, about the particle's own prediction."""
        return self.variance * dt_s**2 + self.change * dt_s**3 / 3 + self.jitter * dt_s

    def update(self, rates: Array, shift: Array, dt_s: float) -> tuple[Array, RateFilter]:
        """Rates (N, 6 + J) after a frame in which the poses ended ``shift`` (N, 6 + J) from their predictions."""
        predicted = self.variance + self.change * dt_s
        gain = predicted * dt_s / (predicted * dt_s**2 + self.jitter * dt_s)
        return rates + gain * shift, replace(self, variance=(1 - gain * dt_s) * predicted)


def rate_filter(params: MotionParams, domain: Domain, variance: Array | None) -> RateFilter:
    """The filter of a session; ``variance`` is that of the frame before, None before there was one."""
    jitter = diffusion(params, domain)
    if params.kind == "jitter":
        return RateFilter(np.zeros_like(jitter), jitter**2, np.zeros_like(jitter))
    if variance is None:
        variance = (params.rate_spread * jitter) ** 2
    return RateFilter(variance, jitter**2, (params.rate_change * jitter) ** 2)

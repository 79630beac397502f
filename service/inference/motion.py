"""Between frames: the jitter of the paper, and constant rates."""

from __future__ import annotations

from dataclasses import dataclass

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
class MotionNoise:
    """Over dt a pose moves by v dt plus jitter of variance q dt, and its rate v by a random step of variance r dt."""

    variance: Array  # (6 + J,) V of a rate that nothing is known of, tangent units^2 / s^2
    jitter: Array  # (6 + J,) q, tangent units^2 / s
    change: Array  # (6 + J,) r, tangent units^2 / s^3


def motion_noise(params: MotionParams, domain: Domain) -> MotionNoise:
    """Of a session."""
    jitter = diffusion(params, domain)
    if params.kind == "jitter":
        return MotionNoise(np.zeros_like(jitter), jitter**2, np.zeros_like(jitter))
    return MotionNoise((params.rate_spread * jitter) ** 2, jitter**2, (params.rate_change * jitter) ** 2)

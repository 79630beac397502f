"""How the body moves during a pass: constant-rate tumbling, pointing wobble, a change of range, joints."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from service.inference.articulation import Articulation, Joint
from service.inference.pose import exp_so3, multiply
from service.inference.state import Array, Poses


@dataclass(frozen=True)
class Motion:
    """A pass. ``None`` means: drawn from the pass's own random numbers."""

    frames: int = 40
    """Number of frames."""
    frame_interval_s: float = 0.1
    """Time between them."""
    orientation: tuple[float, float, float, float] | None = None
    """First orientation, body to camera (w, x, y, z)."""
    rate_deg_s: float = 6.0
    """Rate of the tumbling, constant in the body frame."""
    rate_axis: tuple[float, float, float] | None = None
    """Its axis in the body frame."""
    extent: float = 0.65
    """Diameter of the body's bounding sphere over the image's shorter side, in the first frame."""
    scale_drift_per_s: float = 0.0
    """Relative change of the scale per second (the range changes)."""
    position_share: tuple[float, float] = (0.53, 0.48)
    """Mean position over the image's width and height."""
    wobble_px: float = 0.6
    """Standard deviation of the mount's wobble (Ornstein-Uhlenbeck), in each axis."""
    wobble_time_s: float = 0.5
    """Its correlation time."""
    drift_px_s: tuple[float, float] = (0.0, 0.0)
    """Steady drift across the image."""
    joints: tuple[str, ...] | None = None
    """Joints that move; ``None``: all of them."""
    joint_rate_deg_s: float = 12.0
    """Rate of each revolute joint; a prismatic one moves by the same share of its range."""
    joint_start_deg: float | None = None
    """First value of the revolute joints."""
    outage: tuple[int, int] | None = None
    """First frame without the body, and how many."""


@dataclass(frozen=True)
class Track:
    """The truth of a pass: one pose per frame."""

    time_s: Array  # (K,)
    poses: Poses  # K of them, all joints of the articulation
    visible: np.ndarray[tuple[int], np.dtype[np.bool_]]  # (K,)


def plan_track(
    motion: Motion,
    articulation: Articulation,
    radius: float,
    size: tuple[int, int],
    rng: np.random.Generator,
    shake_px: float = 0.0,
) -> Track:
    """The poses of a pass in images of ``size`` (width, height), for a body of this bounding ``radius``.

    ``shake_px`` is the image motion of the atmosphere, uncorrelated from frame to frame; it is part of the
    truth because where the body is seen is what a tracker measures.
    """
    time_s: Array = np.arange(motion.frames, dtype=np.float64) * motion.frame_interval_s
    axis = _axis(motion, rng)
    start = _orientation(motion, rng)
    turned = exp_so3(np.deg2rad(motion.rate_deg_s) * time_s[:, None] * axis)
    centre = np.array(motion.position_share) * size
    position = centre + time_s[:, None] * np.array(motion.drift_px_s) + _wobble(motion, rng)
    position += shake_px * rng.standard_normal((motion.frames, 2))
    first_scale = motion.extent * min(size) / (2.0 * radius)
    log_scale = np.log(first_scale) + np.log1p(motion.scale_drift_per_s) * time_s
    joints = [_joint_track(joint, motion, time_s, rng) for joint in articulation.joints]
    visible = np.ones(motion.frames, dtype=np.bool_)
    if motion.outage is not None:
        first, count = motion.outage
        visible[first : first + count] = False
    quaternion = multiply(np.broadcast_to(start, turned.shape), turned)
    columns = np.stack(joints, axis=1) if joints else np.zeros((motion.frames, 0))
    return Track(time_s, Poses(quaternion, position, log_scale, columns), visible)


def _axis(motion: Motion, rng: np.random.Generator) -> Array:
    drawn = rng.standard_normal(3)
    axis = drawn if motion.rate_axis is None else np.array(motion.rate_axis, dtype=np.float64)
    return np.asarray(axis / np.linalg.norm(axis), dtype=np.float64)


def _orientation(motion: Motion, rng: np.random.Generator) -> Array:
    drawn = Rotation.random(random_state=rng).as_quat(canonical=True, scalar_first=True)
    if motion.orientation is None:
        return np.asarray(drawn, dtype=np.float64)
    given = np.array(motion.orientation, dtype=np.float64)
    return np.asarray(given / np.linalg.norm(given))


def _wobble(motion: Motion, rng: np.random.Generator) -> Array:
    """(K, 2) Ornstein-Uhlenbeck process, stationary from the first frame on."""
    keep = float(np.exp(-motion.frame_interval_s / motion.wobble_time_s))
    noise = rng.standard_normal((motion.frames, 2))
    out = np.empty_like(noise)
    out[0] = noise[0]
    for k in range(1, motion.frames):
        out[k] = keep * out[k - 1] + np.sqrt(1 - keep * keep) * noise[k]
    return np.asarray(motion.wobble_px * out)


def _joint_track(joint: Joint, motion: Motion, time_s: Array, rng: np.random.Generator) -> Array:
    """(K,) values: a constant rate that turns back at the limits, or goes round where the joint can."""
    share, sign = rng.uniform(), rng.choice([-1.0, 1.0])
    if motion.joints is not None and joint.name not in motion.joints:
        return np.full(len(time_s), joint.initial)
    span = joint.maximum - joint.minimum
    start, rate = joint.minimum + share * span, sign * motion.joint_rate_deg_s
    if joint.kind == "prismatic":
        rate *= span / 360.0
    elif motion.joint_start_deg is not None:
        start, rate = motion.joint_start_deg, motion.joint_rate_deg_s
    travelled = start + rate * time_s - joint.minimum
    if span <= 0:
        return np.full(len(time_s), joint.minimum)
    if joint.kind == "revolute" and span >= 360.0:
        return np.asarray(joint.minimum + travelled % span)
    folded = travelled % (2 * span)
    return np.asarray(joint.minimum + np.where(folded > span, 2 * span - folded, folded))

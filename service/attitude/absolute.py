"""Body -> GCRF: the paper's relative pose made absolute by the known orientation of the camera."""

from __future__ import annotations

import numpy as np

from service.inference.pose import conjugate, from_matrices, log_so3, multiply, rotation_matrices
from service.inference.state import Array


def absolute_quaternion(camera: Array, quaternion: Array) -> Array:
    """(4,) body -> GCRF, w >= 0, of ``camera`` (3, 3) camera -> GCRF and ``quaternion`` (4,) body -> camera."""
    return from_matrices(camera @ rotation_matrices(quaternion))


def covariance_in_gcrf(quaternion: Array, covariance: Array) -> Array:
    """(3, 3) covariance about GCRF axes of one about body axes: A P A' with A of ``quaternion`` body -> GCRF."""
    rotation = rotation_matrices(quaternion)
    return np.asarray(rotation @ covariance @ rotation.T, dtype=np.float64)


def camera_rate(before: Array, now: Array, dt_s: float) -> Array:
    """(3,) mean angular velocity between two camera -> GCRF rotations (3, 3), in axes of the later camera, rad/s.

    A rate about a fixed axis has the same components in both cameras; for others this is right to first order.
    """
    relative = multiply(conjugate(from_matrices(before)), from_matrices(now))
    return log_so3(relative) / dt_s


def body_rate(quaternion: Array, relative_rate: Array, rate_of_camera: Array) -> Array:
    """(3,) angular velocity of the body against GCRF, in body axes, rad/s.

    ``quaternion`` (4,) body -> camera, ``relative_rate`` (3,) of the body against the camera in body axes,
    ``rate_of_camera`` (3,) of the camera against GCRF in camera axes: angular velocities add in one set of axes.
    """
    return relative_rate + rotation_matrices(quaternion).T @ rate_of_camera

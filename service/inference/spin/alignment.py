"""Orientations that take axes to axes, and how far one is from them."""

from __future__ import annotations

from itertools import product

import numpy as np

from service.inference.pose import conjugate, log_so3, multiply, rotation_matrices
from service.inference.spin.frames import LOG_UNIFORM
from service.inference.state import Array

OFFSET_SIGMA = float(np.deg2rad(5.0))  # prior: rad, each axis: of a body axis that is held, about where it should be
ALIGNED = 0.5  # prior: that a body which is held in a moving frame has its mesh's axes along that frame's


def alignments() -> Array:
    """(24, 4) rotations that take axes to axes: the unit quaternions along axes, edges and corners of a cube in 4-D."""
    ways = np.array([way for way in product((1, 0, -1), repeat=4) if any(way)], np.float64)
    first = ways[np.arange(len(ways)), (ways != 0).argmax(axis=1)]
    some = ways[(first > 0) & np.isin(np.abs(ways).sum(axis=1), (1, 2, 4))]  # three of four alike: no such rotation
    return np.asarray(some / np.linalg.norm(some, axis=1, keepdims=True))


def offset(quaternion: Array) -> tuple[Array, Array]:
    """(3,) rad: turn about the reference's axes from the nearest of ``ALIGNMENTS`` to (4,), and that (4,)."""
    turns = log_so3(multiply(quaternion, conjugate(ALIGNMENTS)))
    k = int(np.argmin(np.linalg.norm(turns, axis=1)))
    return turns[k], ALIGNMENTS[k]


def tilt(quaternion: Array) -> tuple[float, int]:
    """Rad from the reference's z to the nearest body axis of (4,), and its number: x, y, z, -x, -y, -z."""
    toward = rotation_matrices(quaternion)[2]
    k = int(np.argmax(np.concatenate([toward, -toward])))
    return float(np.arccos(np.clip(np.abs(toward[k % 3]), 0.0, 1.0))), k


ALIGNMENTS = alignments()


def log_aligned_or_any(quaternion: Array) -> Array:
    """(B,) log density per rad^3 of orientations (B, 4) body -> reference: normal about each alignment, or any."""
    turns = log_so3(multiply(quaternion[:, None], conjugate(ALIGNMENTS)))
    squares = np.sum(turns**2, axis=2) / OFFSET_SIGMA**2
    near = np.logaddexp.reduce(-0.5 * squares, axis=1) - np.log(24) - 1.5 * np.log(2 * np.pi * OFFSET_SIGMA**2)
    return np.asarray(np.logaddexp(np.log(ALIGNED) + near, np.log(1 - ALIGNED) + LOG_UNIFORM))


def log_axis_along_z(quaternion: Array) -> Array:
    """(B,) the same: normal of the angle between the reference's z and one of six body axes, any turn about it."""
    cosine = rotation_matrices(quaternion)[:, 2]
    angles = np.arccos(np.clip(np.concatenate([cosine, -cosine], axis=1), -1.0, 1.0))
    near = np.logaddexp.reduce(-0.5 * (angles / OFFSET_SIGMA) ** 2, axis=1)
    return np.asarray(near - np.log(6) - np.log(2 * np.pi * OFFSET_SIGMA**2) - np.log(2 * np.pi))

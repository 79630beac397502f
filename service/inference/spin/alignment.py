"""Orientations that take axes to axes, and how far one is from them."""

from __future__ import annotations

from itertools import product

import numpy as np

from service.inference.pose import conjugate, log_so3, multiply, rotation_matrices
from service.inference.state import Array


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

"""Orientations that take axes to axes, and how far one is from them."""

from __future__ import annotations

from itertools import permutations, product

import numpy as np

from service.inference.pose import conjugate, exp_so3, log_so3, multiply, rotation_matrices
from service.inference.state import Array


def alignments() -> Array:
    """(24, 4) rotations that take axes to axes."""
    found = []
    for order in permutations(range(3)):
        for signs in product((1.0, -1.0), repeat=3):
            matrix = np.zeros((3, 3))
            matrix[range(3), order] = signs
            if np.linalg.det(matrix) > 0:
                found.append(_quaternion(matrix))
    return np.array(found)


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


def _quaternion(matrix: Array) -> Array:
    """(4,) of a rotation that takes axes to axes."""
    turns = [exp_so3(np.pi / 2 * k * np.eye(3)[axis]) for axis in range(3) for k in range(4)]
    every = [multiply(multiply(a, b), c) for a in turns[:4] for b in turns[4:8] for c in turns[8:]]
    return min(every, key=lambda q: float(np.abs(rotation_matrices(q) - matrix).max()))


ALIGNMENTS = alignments()

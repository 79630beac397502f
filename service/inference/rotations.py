"""Even coverings of the space of rotations."""

from __future__ import annotations

import numpy as np

from service.inference.pose import multiply
from service.inference.state import Array

_PHI = np.sqrt(2.0)
_PSI = 1.533751168755204288118041  # the positive root of x^4 = x + 4


def random_rotations(rng: np.random.Generator, count: int) -> Array:
    """(N, 4) independent, uniform on SO(3)."""
    q = rng.standard_normal((count, 4))
    return np.asarray(q / np.linalg.norm(q, axis=1, keepdims=True))


def spread_rotations(rng: np.random.Generator, count: int) -> Array:
    """(N, 4) super-Fibonacci spiral (Alexa, CVPR 2022), turned as a whole by a uniform rotation.

    Low discrepancy, and each member is uniform on SO(3) over the random turn.
    """
    s = np.arange(count) + 0.5
    t = s / count
    r, big_r = np.sqrt(t), np.sqrt(1 - t)
    alpha, beta = 2 * np.pi * s / _PHI, 2 * np.pi * s / _PSI
    q = np.stack([r * np.sin(alpha), r * np.cos(alpha), big_r * np.sin(beta), big_r * np.cos(beta)], axis=1)
    return multiply(random_rotations(rng, 1), q)

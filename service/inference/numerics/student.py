"""Multivariate Student t: what a Gaussian becomes where the size of its noise is known to a factor only."""

from __future__ import annotations

import numpy as np
from scipy.special import fdtr, fdtri, gammaln

from service.inference.state import Array


def squared_radius(share: float, dimensions: int, degrees: float) -> float:
    """d' C^-1 d below which ``share`` of a Student t with scale C lies: Fisher's F times the dimensions."""
    return float(dimensions * fdtri(dimensions, degrees, share))


def share_within(square: float, dimensions: int, degrees: float) -> float:
    """Of a Student t with scale C, what lies below this d' C^-1 d: the inverse of ``squared_radius``."""
    return float(fdtr(dimensions, degrees, square / dimensions))


def scale_of(covariance: Array, degrees: float) -> Array:
    """C of a Student t of this covariance, which is wider; more than two ``degrees``."""
    return np.asarray((degrees - 2) / degrees * covariance)


def root_of(covariance: Array) -> Array:
    """(D, D) R with R R' = covariance, which may lack a direction by rounding: less than nothing is zero."""
    size = np.sqrt(np.maximum(np.diag(covariance), 1e-300))
    values, vectors = np.linalg.eigh(covariance / np.outer(size, size))
    return np.asarray(size[:, None] * vectors * np.sqrt(np.maximum(values, 0.0)))


def draw(rng: np.random.Generator, scale: Array, degrees: float, count: int) -> Array:
    """(count, D) draws about zero, ``scale`` (D, D)."""
    root = root_of(scale)
    wide = np.sqrt(degrees / rng.chisquare(degrees, size=count))
    return np.asarray(rng.standard_normal((count, len(scale))) @ root.T * wide[:, None])


def log_density(offsets: Array, scale: Array, degrees: float) -> Array:
    """(N, D) offsets from the middle -> (N,)."""
    d = len(scale)
    root = np.linalg.cholesky(scale)
    square = np.sum(np.linalg.solve(root, offsets.T) ** 2, axis=0)
    constant = gammaln((degrees + d) / 2) - gammaln(degrees / 2) - 0.5 * d * np.log(degrees * np.pi)
    return np.asarray(constant - np.log(np.diag(root)).sum() - (degrees + d) / 2 * np.log1p(square / degrees))

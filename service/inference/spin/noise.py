"""Frames that err alike: errors of a drawn body stay while its aspect does (docs/motion.md).

The whitened errors z of n frames, each of three axes by itself, have the covariance s^2 K,
K_ij = a exp(-|t_i - t_j| / tau) + (1 - a) [i = j] / u_i: a share a that stays for some tau, the rest each frame's own,
with the weights u_i of a Student t. The first is Markov, so its precision is tridiagonal and all sums take O(n).
Frames of two telescopes see the body from two sides: their errors are independent, under one law.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_solve_banded, cholesky_banded

from service.inference.state import Array

SHARES = (0.1, 0.25, 0.5, 0.8, 0.9, 0.95, 0.98)
"""Prior: of the variance that stays, all alike, and none. A track in turbulence scatters by a fifth of what it is off:
what a frame's stated spread holds and its neighbours do not show is an error that stays."""
LASTS_S = (0.3, 1.0, 3.0, 10.0, 30.0, 100.0)  # prior: log-uniform from frames' intervals to a pass
_AROUND = np.linspace(-2.5, 2.5, 7)  # numerical: places of s about its best, in standard deviations of its log
_SCALE_LOG_SIGMA = 0.5  # prior: stated spreads are right within a factor 1.6
_LEAST_STEP_S = 1e-4  # numerical: frames of one time


@dataclass(frozen=True)
class Linear:
    """Errors as they depend on P parameters: z = residual + jacobian step, whitened; n frames."""

    time_s: Array  # (n,)
    residual: Array  # (n, 3)
    jacobian: Array  # (n, 3, P)
    weight: Array  # (n,) u, positive
    precision: Array  # (P,) of the Gaussian prior
    away: Array  # (P,) from its mean
    station: NDArray[np.intp]  # (n,) frames of two of them err independently

    def parts(self) -> list[NDArray[np.intp]]:
        """Rows of each station."""
        return [np.flatnonzero(self.station == k) for k in np.unique(self.station)]


@dataclass(frozen=True)
class Solved:
    """The posterior of the steps, and what the frames are worth."""

    mean: Array  # (P,)
    covariance: Array  # (P, P)
    log_evidence: float  # but for the prior's density at the point and the roots' determinants
    scale: float  # posterior mean of s
    stays: float  # posterior mean of a
    independent: float  # posterior mean of the number of frames, were each to err by itself
    own_squares: Array  # (n,) expected squares of what is each frame's own, in units of its variance but for u


def solve(linear: Linear) -> Solved:
    """Marginal over a, tau and s on a grid: a mixture of Gaussians, told by its first two moments."""
    means, spreads, logs, facts, places = [], [], [], [], []
    for a, tau, log_prior in _grid():
        sums = _sums(linear, a, tau)
        scales, width = _scales(linear, sums)
        mean, spread, log = _at_scales(linear, sums, scales)
        means.append(mean)
        spreads.append(spread)
        logs.append(log + np.log(width) + log_prior)
        facts += [(scale, a, sums.independent) for scale in scales]
        places += [(a, tau, scale, step) for scale, step in zip(scales, mean, strict=True)]
    found = np.concatenate(logs)
    total = float(np.logaddexp.reduce(found))
    weight = np.exp(found - total)
    every = np.concatenate(means)
    mean = weight @ every
    apart = every - mean
    covariance = np.einsum("g,gij->ij", weight, np.concatenate(spreads))
    covariance += np.einsum("g,gi,gj->ij", weight, apart, apart)
    scale, stays, independent = weight @ np.array(facts)
    own = _own_squares(linear, *places[int(np.argmax(found))])
    return Solved(mean, covariance, total, float(scale), float(stays), float(independent), own)


def _grid() -> Iterator[tuple[float, float, float]]:
    """Share, tau, and the log of their prior probability: every share as likely, and every tau."""
    each = -float(np.log(len(SHARES) + 1))
    yield 0.0, 1.0, each
    for a, tau in product(SHARES, LASTS_S):
        yield a, tau, each - float(np.log(len(LASTS_S)))


def _scales(linear: Linear, sums: _Sums) -> tuple[Array, float]:
    """Places of s about its best, and the log of s between two of them."""
    sure = 2 * 3 * len(linear.residual) + _SCALE_LOG_SIGMA**-2  # curvature in log s at the best
    scale = 1.0
    for _ in range(3):
        step = _at_scales(linear, sums, np.array([scale]))[0][0]
        left = sums.squares + 2 * step @ sums.slope + step @ sums.normal @ step
        wanted = 0.5 * np.log(left / (3 * len(linear.residual)))
        scale = float(np.exp(wanted * (1 - _SCALE_LOG_SIGMA**-2 / sure)))
    spacing = float(_AROUND[1] - _AROUND[0]) / np.sqrt(sure)
    return scale * np.exp(_AROUND / np.sqrt(sure)), spacing


@dataclass(frozen=True)
class _Sums:
    """What K leaves of the frames."""

    squares: float  # z' K^-1 z over the axes
    slope: Array  # (P,) J' K^-1 z
    normal: Array  # (P, P) J' K^-1 J
    log_determinant: float  # of K, over the axes
    independent: float


def _sums(linear: Linear, a: float, tau: float) -> _Sums:
    axes, p = linear.jacobian.shape[1:]
    inner, log_determinant, independent = np.zeros((p + 1, p + 1)), 0.0, 0.0
    for rows in linear.parts():
        n = len(rows)
        columns = np.concatenate([linear.residual[rows, :, None], linear.jacobian[rows]], axis=2).reshape(n, -1)
        columns = np.column_stack([columns, np.ones(n)])
        inverse = linear.weight[rows] / (1 - a)
        whitened = columns * inverse[:, None]
        log_determinant -= float(np.sum(np.log(inverse)))
        if a > 0.0:
            banded, log_markov = _markov_precision(linear.time_s[rows], tau)
            banded = banded / a
            banded[1] += inverse
            root = cholesky_banded(banded)
            log_determinant += 2 * float(np.sum(np.log(root[1]))) - (log_markov - n * np.log(a))
            whitened = whitened - inverse[:, None] * cho_solve_banded((root, False), whitened)
        gram = columns.T @ whitened
        independent += min(float(gram[-1, -1]) / float(np.sum(inverse) * (1 - a)), 1.0) * n
        inner += np.einsum("iaib->ab", gram[:-1, :-1].reshape(axes, p + 1, axes, p + 1))
    return _Sums(float(inner[0, 0]), inner[1:, 0], inner[1:, 1:], axes * log_determinant, independent)


def _own_squares(linear: Linear, a: float, tau: float, scale: float, step: Array) -> Array:
    """(n,) of z less what stays, its uncertainty included: E |z - b|^2 / ((1 - a) s^2)."""
    z = linear.residual + linear.jacobian @ step
    if a == 0.0:
        return np.asarray(np.sum(z**2, axis=1) / scale**2)
    squares = np.empty(len(z))
    for rows in linear.parts():
        inverse = linear.weight[rows] / (1 - a)
        banded = _markov_precision(linear.time_s[rows], tau)[0] / a
        banded[1] += inverse
        spread = cho_solve_banded((cholesky_banded(banded), False), np.eye(len(rows)))
        own = z[rows] - spread @ (inverse[:, None] * z[rows])
        squares[rows] = (np.sum(own**2, axis=1) / scale**2 + 3 * np.diag(spread)) / (1 - a)
    return squares


def _markov_precision(time_s: Array, tau: float) -> tuple[Array, float]:
    """Upper banded (2, n) precision of exp(-|t_i - t_j| / tau), and the log of its determinant."""
    kept = np.exp(-np.maximum(np.diff(time_s), _LEAST_STEP_S) / tau)
    new = 1 - kept**2
    diagonal = np.ones(len(time_s))
    diagonal[1:] = 1 / new
    diagonal[:-1] += kept**2 / new
    banded = np.zeros((2, len(time_s)))
    banded[1] = diagonal
    banded[0, 1:] = -kept / new
    return banded, -float(np.sum(np.log(new)))


def _at_scales(linear: Linear, sums: _Sums, scales: Array) -> tuple[Array, Array, Array]:
    """Steps (S, P), their covariances, and log evidences (S,), the prior of s included, at each s (S,)."""
    p, n = len(linear.precision), len(linear.residual)
    normal = sums.normal / scales[:, None, None] ** 2 + np.diag(linear.precision)
    slope = -sums.slope / scales[:, None] ** 2 - linear.precision * linear.away
    found = np.linalg.inv(normal)
    inverse = np.asarray(0.5 * (found + np.swapaxes(found, 1, 2)))
    step = np.einsum("sij,sj->si", inverse, slope)
    log = -0.5 * (sums.squares / scales**2 + 6 * n * np.log(scales) + sums.log_determinant + 3 * n * np.log(2 * np.pi))
    log += 0.5 * np.sum(slope * step, axis=1) + 0.5 * p * np.log(2 * np.pi) - 0.5 * np.linalg.slogdet(normal)[1]
    log -= 0.5 * (np.log(scales) / _SCALE_LOG_SIGMA) ** 2 + np.log(_SCALE_LOG_SIGMA) + 0.5 * np.log(2 * np.pi)
    return step, np.asarray(inverse), np.asarray(log)

"""Frames that err alike: errors of a drawn body stay while its aspect does (docs/motion.md).

The whitened errors z of n frames, each of three axes by itself, have the covariance s^2 K,
K_ij = a exp(-|t_i - t_j| / tau) + (1 - a) [i = j] / u_i: a share a that stays for some tau, the rest each frame's own,
with the weights u_i of a Student t. The first is Markov, so its precision is tridiagonal and all sums take O(n).
Frames of two telescopes see the body from two sides, each through its own air: their errors are independent, and each
has its own a, tau and s.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_solve_banded, cholesky_banded

from service.inference.state import Array

# prior: of the variance that stays, each as likely
SHARES = (0.1, 0.25, 0.5, 0.8, 0.9, 0.95, 0.98)
"""Beside none. A track in turbulence scatters by a fifth of what it is off:
what a frame's stated spread holds and its neighbours do not show is an error that stays."""
LASTS_S = (0.3, 1.0, 3.0, 10.0, 30.0, 100.0)  # prior: log-uniform from frames' intervals to a pass
_AROUND = np.linspace(-2.5, 2.5, 7)  # numerical: places of s about its best, in standard deviations of its log
_SCALE_LOG_SIGMA = 0.5  # prior: stated spreads are right within a factor 1.6
_LEAST_STEP_S = 1e-4  # numerical: frames of one time
_TOGETHER = 64  # numerical: laws of all stations together that are looked at
_AXES = 3  # exact: of a rotation


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

    def of(self, rows: NDArray[np.intp]) -> Linear:
        """Some of the frames alone."""
        return Linear(
            self.time_s[rows],
            self.residual[rows],
            self.jacobian[rows],
            self.weight[rows],
            self.precision,
            self.away,
            self.station[rows],
        )

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
    """Marginal over a, tau and s on a grid: a mixture of Gaussians, told by its first two moments.

    Each station errs by a law of its own: of each those laws are kept that explain it best.
    """
    means, spreads, logs, facts, places = [], [], [], [], []
    for laws in product(*_laws_of_stations(linear)):
        sums = _together(laws)
        scales, width = _scales(linear, sums)
        mean, spread, log = _at_scales(linear, sums, scales)
        means.append(mean)
        spreads.append(spread)
        logs.append(log + np.log(width) + sum(law.log_prior for law in laws))
        own = np.average([(law.scale, law.stays) for law in laws], axis=0, weights=[law.frames for law in laws])
        facts += [(scale * own[0], own[1], sums.independent) for scale in scales]
        places += [(laws, scale, step) for scale, step in zip(scales, mean, strict=True)]
    found = np.concatenate(logs)
    total = float(np.logaddexp.reduce(found))
    weight = np.exp(found - total)
    every = np.concatenate(means)
    mean = weight @ every
    apart = every - mean
    covariance = np.einsum("g,gij->ij", weight, np.concatenate(spreads))
    covariance += np.einsum("g,gi,gj->ij", weight, apart, apart)
    scale, stays, independent = weight @ np.array(facts)
    own_squares = _own_squares(linear, *places[int(np.argmax(found))])
    return Solved(mean, covariance, total, float(scale), float(stays), float(independent), own_squares)


@dataclass(frozen=True)
class _Law:
    """How one station's frames may err, and what that leaves of them."""

    stays: float  # a
    tau: float
    log_prior: float
    scale: float  # of this station; the one of all together comes on top
    frames: int
    sums: _Sums  # in units of its scale


def _laws_of_stations(linear: Linear) -> list[list[_Law]]:
    """Of each station: all on the grid where it is alone; else its best, each at its own best scale."""
    parts = linear.parts()
    kept = max(1, int(_TOGETHER ** (1 / len(parts))))
    found = []
    for rows in parts:
        laws = [(a, tau, log, _sums(linear, rows, a, tau)) for a, tau, log in _grid()]
        if len(parts) == 1:
            found.append([_Law(a, tau, log, 1.0, len(rows), sums) for a, tau, log, sums in laws])
            continue
        own, tried = linear.of(rows), []
        for a, tau, log, sums in laws:
            scale = float(np.median(_scales(own, sums)[0]))
            evidence = log + float(_at_scales(own, sums, np.array([scale]))[2][0])
            wide = -0.5 * (np.log(scale) / _SCALE_LOG_SIGMA) ** 2
            tried.append((evidence, _Law(a, tau, log + wide, scale, len(rows), sums.scaled(scale, len(rows)))))
        found.append([law for _, law in sorted(tried, key=lambda one: -one[0])[:kept]])
    return found


def _together(laws: Sequence[_Law]) -> _Sums:
    """Of independent stations."""
    every = [law.sums for law in laws]
    return _Sums(
        sum(one.squares for one in every),
        np.sum([one.slope for one in every], axis=0),
        np.sum([one.normal for one in every], axis=0),
        sum(one.log_determinant for one in every),
        sum(one.independent for one in every),
    )


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

    def scaled(self, scale: float, n: int) -> _Sums:
        """Of n frames whose errors are so many times as large."""
        more, squared = 2 * _AXES * n * float(np.log(scale)), scale**2
        kept = self.log_determinant + more, self.independent
        return _Sums(self.squares / squared, self.slope / squared, self.normal / squared, *kept)


def _sums(linear: Linear, rows: NDArray[np.intp], a: float, tau: float) -> _Sums:
    """Of one station's frames."""
    n, axes, p = len(rows), *linear.jacobian.shape[1:]
    columns = np.concatenate([linear.residual[rows, :, None], linear.jacobian[rows]], axis=2).reshape(n, -1)
    columns = np.column_stack([columns, np.ones(n)])
    inverse = linear.weight[rows] / (1 - a)
    whitened = columns * inverse[:, None]
    log_determinant = -float(np.sum(np.log(inverse)))
    if a > 0.0:
        banded, log_markov = _markov_precision(linear.time_s[rows], tau)
        banded = banded / a
        banded[1] += inverse
        root = cholesky_banded(banded)
        log_determinant += 2 * float(np.sum(np.log(root[1]))) - (log_markov - n * np.log(a))
        whitened = whitened - inverse[:, None] * cho_solve_banded((root, False), whitened)
    gram = columns.T @ whitened
    independent = float(gram[-1, -1]) / float(np.sum(inverse) * (1 - a)) * n
    gram = gram[:-1, :-1].reshape(axes, p + 1, axes, p + 1)
    inner = np.einsum("iaib->ab", gram)
    return _Sums(float(inner[0, 0]), inner[1:, 0], inner[1:, 1:], axes * log_determinant, min(independent, float(n)))


def _own_squares(linear: Linear, laws: Sequence[_Law], scale: float, step: Array) -> Array:
    """(n,) of z less what stays, its uncertainty included: E |z - b|^2 / ((1 - a) s^2)."""
    z = linear.residual + linear.jacobian @ step
    squares = np.empty(len(z))
    for rows, law in zip(linear.parts(), laws, strict=True):
        a, s = law.stays, scale * law.scale
        if a == 0.0:
            squares[rows] = np.sum(z[rows] ** 2, axis=1) / s**2
            continue
        inverse = linear.weight[rows] / (1 - a)
        banded = _markov_precision(linear.time_s[rows], law.tau)[0] / a
        banded[1] += inverse
        spread = cho_solve_banded((cholesky_banded(banded), False), np.eye(len(rows)))
        own = z[rows] - spread @ (inverse[:, None] * z[rows])
        squares[rows] = (np.sum(own**2, axis=1) / s**2 + 3 * np.diag(spread)) / (1 - a)
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

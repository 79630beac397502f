"""Frames that err alike: errors of a drawn body stay while its aspect does (docs/motion.md).

The whitened errors z of n frames, each of three axes by itself, have the covariance s^2 K,
K_ij = a m(|t_i - t_j| / tau) + (1 - a) [i = j] / u_i: a share a that stays for some tau, the rest each frame's own,
with the weights u_i of a Student t. What stays is rough, as air is, or smooth, as a body's aspect changes: m is the
Matern kernel of 1/2 or of 3/2 (Rasmussen, Williams: Gaussian Processes for Machine Learning, section 4.2.1),
exp(-x) or (1 + r) exp(-r), r = 3^(1/2) x. Both are Markov, the second with its slope, so their precision is banded
and all sums take O(n).
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
from scipy.special import gammainc

from service.inference.state import Array

# prior: of the variance that stays, each as likely
SHARES = (0.1, 0.25, 0.5, 0.8, 0.9, 0.95, 0.98)
"""Beside none. A track in turbulence scatters by a fifth of what it is off:
what a frame's stated spread holds and its neighbours do not show is an error that stays."""
LASTS_S = (0.3, 1.0, 3.0, 10.0, 30.0, 100.0)  # prior: log-uniform from frames' intervals to a pass
_AROUND = np.linspace(-2.5, 2.5, 7)  # numerical: places of s about its best, in standard deviations of its log
SCALE_LOG_SIGMA = 0.35  # prior: stated spreads are right within a factor 1.4, as frames' regions show
_LEAST_STEP = 3e-4  # numerical: of x or r between frames: the precision grows as its cube
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
    smooth: bool
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
        laws = [(a, tau, smooth, log, _sums(linear, rows, a, tau, smooth)) for a, tau, smooth, log in _grid()]
        if len(parts) == 1:
            found.append([_Law(a, tau, smooth, log, 1.0, len(rows), sums) for a, tau, smooth, log, sums in laws])
            continue
        own, tried = linear.of(rows), []
        for a, tau, smooth, log, sums in laws:
            scale = float(np.median(_scales(own, sums)[0]))
            evidence = log + float(_at_scales(own, sums, np.array([scale]))[2][0])
            wide = -0.5 * (np.log(scale) / SCALE_LOG_SIGMA) ** 2
            tried.append((evidence, _Law(a, tau, smooth, log + wide, scale, len(rows), sums.scaled(scale, len(rows)))))
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


def _grid() -> Iterator[tuple[float, float, bool, float]]:
    """Share, tau, whether smooth, and the log of their prior probability: every share as likely, tau and smoothness."""
    each = -float(np.log(len(SHARES) + 1))
    yield 0.0, 1.0, False, each
    for a, tau, smooth in product(SHARES, LASTS_S, (False, True)):
        yield a, tau, smooth, each - float(np.log(2 * len(LASTS_S)))


def _scales(linear: Linear, sums: _Sums) -> tuple[Array, float]:
    """Places of s about its best, and the log of s between two of them."""
    sure = 2 * 3 * len(linear.residual) + SCALE_LOG_SIGMA**-2  # curvature in log s at the best
    scale = 1.0
    for _ in range(3):
        step = _at_scales(linear, sums, np.array([scale]))[0][0]
        left = sums.squares + 2 * step @ sums.slope + step @ sums.normal @ step
        wanted = 0.5 * np.log(left / (3 * len(linear.residual)))
        scale = float(np.exp(wanted * (1 - SCALE_LOG_SIGMA**-2 / sure)))
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


def _sums(linear: Linear, rows: NDArray[np.intp], a: float, tau: float, smooth: bool) -> _Sums:
    """Of one station's frames."""
    n, axes, p = len(rows), *linear.jacobian.shape[1:]
    columns = np.concatenate([linear.residual[rows, :, None], linear.jacobian[rows]], axis=2).reshape(n, -1)
    columns = np.column_stack([columns, np.ones(n)])
    inverse = linear.weight[rows] / (1 - a)
    whitened = columns * inverse[:, None]
    log_determinant = -float(np.sum(np.log(inverse)))
    if a > 0.0:
        root, log_markov = _staying(linear.time_s[rows], a, tau, smooth, inverse)
        log_determinant += 2 * float(np.sum(np.log(root[-1]))) - log_markov
        whitened = whitened - inverse[:, None] * _values(root, whitened)
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
        spread = _values(_staying(linear.time_s[rows], a, law.tau, law.smooth, inverse)[0], np.eye(len(rows)))
        own = z[rows] - spread @ (inverse[:, None] * z[rows])
        squares[rows] = (np.sum(own**2, axis=1) / s**2 + 3 * np.diag(spread)) / (1 - a)
    return squares


def _staying(time_s: Array, a: float, tau: float, smooth: bool, inverse: Array) -> tuple[Array, float]:
    """Of what stays, given frames of own variances 1 / inverse (n,): the upper root of its banded precision, and the
    log determinant of its precision before."""
    banded, log_markov = (_smooth_precision if smooth else _rough_precision)(time_s, tau)
    banded /= a
    states = banded.shape[1] // len(time_s)
    banded[-1, ::states] += inverse
    return cholesky_banded(banded), log_markov - banded.shape[1] * float(np.log(a))


def _values(root: Array, columns: Array) -> Array:
    """(n, c) what stays, of the solution for columns (n, c) that act on it and not on its slope."""
    states = root.shape[1] // len(columns)
    both = np.zeros((root.shape[1], columns.shape[1]))
    both[::states] = columns
    return np.asarray(cho_solve_banded((root, False), both)[::states])


def _rough_precision(time_s: Array, tau: float) -> tuple[Array, float]:
    """Upper banded (2, n) precision of exp(-|t_i - t_j| / tau), and the log of its determinant."""
    kept = np.exp(-np.maximum(np.diff(time_s) / tau, _LEAST_STEP))
    new = 1 - kept**2
    diagonal = np.ones(len(time_s))
    diagonal[1:] = 1 / new
    diagonal[:-1] += kept**2 / new
    banded = np.zeros((2, len(time_s)))
    banded[1] = diagonal
    banded[0, 1:] = -kept / new
    return banded, -float(np.sum(np.log(new)))


def _smooth_precision(time_s: Array, tau: float) -> tuple[Array, float]:
    """Upper banded (4, 2n) precision of the value and the slope of Matern's 3/2, both of variance 1.

    Over d = 3^(1/2) dt / tau the two go on by F = exp(-d) [[1 + d, d], [-d, 1 - d]] and gain I - F F'.
    """
    d = np.maximum(np.sqrt(3) * np.diff(time_s) / tau, _LEAST_STEP)
    kept = np.exp(-d)[:, None, None] * np.stack([1 + d, d, -d, 1 - d], axis=1).reshape(-1, 2, 2)
    value, across = gammainc(3, 2 * d), 2 * d**2 * np.exp(-2 * d)  # of I - F F', without cancellation
    slope = value + 4 * d * np.exp(-2 * d)
    determinant = value * slope - across**2
    new = np.stack([slope, -across, -across, value], axis=1).reshape(-1, 2, 2) / determinant[:, None, None]
    carried = new @ kept
    diagonal = np.repeat(np.eye(2)[None], len(time_s), axis=0)
    diagonal[1:] = new
    diagonal[:-1] += np.swapaxes(kept, 1, 2) @ carried
    banded = np.zeros((4, 2 * len(time_s)))
    banded[3, ::2], banded[3, 1::2], banded[2, 1::2] = diagonal[:, 0, 0], diagonal[:, 1, 1], diagonal[:, 0, 1]
    banded[1, 2::2], banded[0, 3::2] = -carried[:, 0, 0], -carried[:, 1, 0]  # of a frame's value with the next frame
    banded[2, 2::2], banded[1, 3::2] = -carried[:, 0, 1], -carried[:, 1, 1]  # of its slope
    return banded, -float(np.sum(np.log(determinant)))


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
    log -= 0.5 * (np.log(scales) / SCALE_LOG_SIGMA) ** 2 + np.log(SCALE_LOG_SIGMA) + 0.5 * np.log(2 * np.pi)
    return step, np.asarray(inverse), np.asarray(log)

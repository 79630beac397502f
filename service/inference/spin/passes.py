"""Spin over several passes: turns counted between them where that is safe, rate and its trend (docs/objects.md).

A body that turns about an axis it keeps has the phase theta(t) = theta_0 + w t + w' t^2 / 2. Each pass tells its rate
and its orientation. Between two passes the twist about the axis is the phase's difference up to whole turns; their
number is counted where the rate known so far, and what it may have changed by, leave no other. What is counted makes
one chain of phases; at a gap that cannot be counted a new chain begins. All rates and phases are linear in w, w' and
the first phases of the chains: one least-squares problem.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from service.inference.pose import conjugate, multiply
from service.inference.state import Array

DRIFT = 0.01 / 86_400  # prior: relative change of a rate, 1/s, one sigma: a hundredth a day
LEAST_PASSES = 2  # contract: below it there is no trend to tell
_SURE_SIGMAS = 6.0  # prior: of the predicted phase within a turn: half a turn is three of them
_LEAST_SCALE = 1.0  # prior: residuals smaller than stated make nothing surer


@dataclass(frozen=True)
class PassSpin:
    """What one pass says, at its middle; rad and s."""

    time_s: float
    quaternion: Array  # (4,) body -> GCRF
    phase_sigma: float  # of the orientation, about the axis
    rate: float  # about the axis that is kept
    rate_sigma: float
    axis: Array  # (3,) of the rate, GCRF
    axis_sigma: float


@dataclass(frozen=True)
class Gap:
    """From one pass to the next."""

    turns: float | None  # with their fraction; None: they cannot be counted
    sigma_turns: float  # of what was expected
    swing: float  # rad: what a turn about the axis does not explain


@dataclass(frozen=True)
class Spin:
    """Rate and trend at ``time_s``."""

    time_s: float
    rate: float
    rate_sigma: float
    change: float  # of the rate, rad/s^2
    change_sigma: float
    axis: Array  # (3,) GCRF
    axis_sigma: float
    scale: float  # by which stated spreads had to be multiplied: 1 where they hold
    gaps: tuple[Gap, ...]

    @property
    def period_s(self) -> tuple[float, float]:
        """2 pi / w, and its sigma."""
        return 2 * np.pi / self.rate, 2 * np.pi * self.rate_sigma / self.rate**2

    @property
    def period_change(self) -> tuple[float, float]:
        """Of the period, s/s, and its sigma."""
        per = 2 * np.pi / self.rate**2
        return -per * self.change, per * self.change_sigma


def spin_of(passes: Sequence[PassSpin]) -> Spin:
    """``LEAST_PASSES`` or more, in order of time, each of a rate that is seen."""
    passes = _one_way(passes)
    middle = 0.5 * (passes[0].time_s + passes[-1].time_s)
    axis, axis_sigma = _axis(passes)
    twists, swings = zip(*(_twist(a, b, axis) for a, b in pairwise(passes)), strict=True)
    counted: list[float | None] = [None] * (len(passes) - 1)
    sigmas = [np.inf] * (len(passes) - 1)
    while True:  # what is counted makes the rate surer, and so the rest countable
        found = _solved(passes, counted, middle)
        fresh = False
        for k in sorted(range(len(counted)), key=lambda k: passes[k + 1].time_s - passes[k].time_s):
            if counted[k] is None:
                expected, sigmas[k] = _expected(passes[k], passes[k + 1], found, middle)
                if _SURE_SIGMAS * sigmas[k] < 2 * np.pi:
                    counted[k] = twists[k] + 2 * np.pi * round((expected - twists[k]) / (2 * np.pi))
                    fresh = True
                    break
        if not fresh:
            break
    gaps = tuple(
        Gap(None if one is None else float(one / (2 * np.pi)), float(sigma / (2 * np.pi)), float(swing))
        for one, sigma, swing in zip(counted, sigmas, swings, strict=True)
    )
    (rate, change), covariance, scale = found
    sigma = np.sqrt(np.diag(covariance))
    return Spin(middle, rate, float(sigma[0]), change, float(sigma[1]), axis, axis_sigma, scale, gaps)


_Found = tuple[tuple[float, float], Array, float]


def _one_way(passes: Sequence[PassSpin]) -> list[PassSpin]:
    """All about one side of the axis: a rate about the other is a negative one."""
    first = passes[0].axis
    return [one if one.axis @ first >= 0 else replace(one, rate=-one.rate, axis=-one.axis) for one in passes]


def _axis(passes: Sequence[PassSpin]) -> tuple[Array, float]:
    """Mean direction by precision; its sigma by what is stated or by scatter, whichever is more."""
    weight = np.array([1 / max(one.axis_sigma, 1e-6) ** 2 for one in passes])
    mean = weight @ np.array([one.axis for one in passes])
    mean /= np.linalg.norm(mean)
    off = np.array([np.arccos(np.clip(one.axis @ mean, -1, 1)) for one in passes])
    scale = max(_LEAST_SCALE, float(np.sqrt(np.sum(weight * off**2) / max(2 * len(passes) - 2, 1))))
    return mean, scale / float(np.sqrt(weight.sum()))


def _twist(one: PassSpin, other: PassSpin, axis: Array) -> tuple[float, float]:
    """Turn about the axis from one pass to the other within (-pi, pi], and the angle of what is left over."""
    turned = multiply(other.quaternion, conjugate(one.quaternion))
    along = float(turned[1:] @ axis)
    swing = 2 * float(np.arccos(np.clip(np.hypot(turned[0], along), 0.0, 1.0)))
    return float(np.angle(np.exp(2j * np.arctan2(along, turned[0])))), swing


def _expected(one: PassSpin, other: PassSpin, found: _Found, middle: float) -> tuple[float, float]:
    """Phase from one pass to the next by the rate known so far, and its sigma."""
    (rate, change), covariance, _ = found
    a, b = one.time_s - middle, other.time_s - middle
    slope = np.array([b - a, 0.5 * (b**2 - a**2)])
    phase_sigma = np.hypot(one.phase_sigma, other.phase_sigma)
    return float(slope @ [rate, change]), float(np.sqrt(slope @ covariance @ slope + phase_sigma**2))


def _solved(passes: Sequence[PassSpin], counted: Sequence[float | None], middle: float) -> _Found:
    """Rate and change at the middle, their covariance, and the scale of the residuals."""
    chain = np.concatenate([[0], np.cumsum([one is None for one in counted])]).astype(int)
    count = 2 + int(chain[-1]) + 1
    rows, values = [], []
    phase = 0.0
    for k, one in enumerate(passes):
        elapsed = one.time_s - middle
        rates = np.zeros(count)
        rates[:2] = 1.0, elapsed
        rows.append(rates / one.rate_sigma)
        values.append(one.rate / one.rate_sigma)
        step = counted[k - 1] if k else None
        phase = 0.0 if step is None else phase + step
        row = np.zeros(count)
        row[:2], row[2 + chain[k]] = (elapsed, 0.5 * elapsed**2), 1.0
        rows.append(row / one.phase_sigma)
        values.append(phase / one.phase_sigma)
    rate = float(np.median([one.rate for one in passes]))
    prior = np.zeros(count)
    prior[1] = 1 / (DRIFT * max(abs(rate), 1e-9))
    rows.append(prior)
    values.append(0.0)
    matrix, wanted = np.array(rows), np.array(values)
    size = np.linalg.norm(matrix, axis=0)
    inverse = np.linalg.pinv((matrix / size).T @ (matrix / size)) / np.outer(size, size)
    best = inverse @ (matrix.T @ wanted)
    free = len(wanted) - count
    scale = float(np.sqrt(np.sum((wanted - matrix @ best) ** 2) / free)) if free > 0 else _LEAST_SCALE
    scale = max(scale, _LEAST_SCALE)
    return (float(best[0]), float(best[1])), inverse[:2, :2] * scale**2, scale

"""Whether a joint stood still over a pass or kept its panel towards the Sun, by evidence (docs/motion.md)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from math import lgamma, log, pi

import numpy as np

from service.inference.spin.basins import JOINT_LAWS, JointLaw
from service.inference.spin.climb import OUTLIER
from service.inference.spin.frames import DEGREES
from service.inference.state import Array

# exact: of the Student t of one number
_LOG_HEIGHT = lgamma((DEGREES + 1) / 2) - lgamma(DEGREES / 2) - 0.5 * log(DEGREES * pi)
_PLACES = np.linspace(-8.0, 8.0, 161)  # numerical: of the constant about its best, in standard deviations
_STARTS = 200  # numerical: frames at whose own values the constant is looked for


@dataclass(frozen=True)
class Seen:
    """A constant as n frames show it, degrees."""

    value: Array  # (n,)
    sigma: Array  # (n,) scales of Student t's
    period: float = np.inf  # values that differ by it are alike


@dataclass(frozen=True)
class SeenJoint:
    """A hinge in n frames."""

    name: str
    value: Seen
    lacks: Seen  # of facing the Sun
    span: float  # degrees that it can turn
    offset_sigma: float  # prior: of a drive's offset from the Sun, degrees; as of ``joints.sun_tracking``


def joint_law(seen: SeenJoint, counted: float) -> JointLaw:
    """``counted``: share of the frames that count, were each to err by itself.

    Still: a value, uniform in the range. Tracking: an offset from the Sun, N(0, ``offset_sigma``). Neither: each
    frame's own value, uniform in the range. An outlier's is uniform, too.
    """
    still = _constant(seen.value, seen.span, counted, lambda c: np.full(len(c), -np.log(seen.span)))
    log_height = np.log(seen.offset_sigma) + 0.5 * np.log(2 * np.pi)
    tracking = _constant(
        seen.lacks, seen.span, counted, lambda c: np.asarray(-0.5 * (c / seen.offset_sigma) ** 2 - log_height)
    )
    logs = np.array([still[0], tracking[0], -counted * len(seen.value.value) * float(np.log(seen.span))])
    shares = np.exp(logs - np.logaddexp.reduce(logs))
    return JointLaw(
        seen.name,
        dict(zip(JOINT_LAWS, shares.tolist(), strict=True)),
        {"still": still[1:], "sun_tracking": (-tracking[1], tracking[2])},
    )


def _constant(
    seen: Seen, span: float, counted: float, log_prior: Callable[[Array], Array]
) -> tuple[float, float, float]:
    """Log evidence of one constant in all frames, its mean and its standard deviation."""

    def log_posterior(constants: Array) -> Array:
        return np.asarray(counted * _log_likelihood(seen, span, constants) + log_prior(constants))

    tried = np.unique(np.linspace(0, len(seen.value) - 1, _STARTS).round().astype(int))
    places = seen.value[tried]
    best = float(places[np.argmax(log_posterior(places))])
    width = 1 / float(np.sqrt(counted * np.sum(seen.sigma**-2.0)))
    for spread in (float(np.median(seen.sigma)), width):  # first to the top, then about it
        places = best + spread * _PLACES
        best = float(places[np.argmax(log_posterior(places))])
    places = best + 2 * width * _PLACES
    logs = log_posterior(places)
    total = float(np.logaddexp.reduce(logs))
    weight = np.exp(logs - total)
    mean = float(weight @ places)
    return total + float(np.log(places[1] - places[0])), mean, float(np.sqrt(weight @ (places - mean) ** 2))


def _log_likelihood(seen: Seen, span: float, constants: Array) -> Array:
    """(C,) of the frames, all counted."""
    away = seen.value - constants[:, None]
    if np.isfinite(seen.period):
        away -= seen.period * np.round(away / seen.period)
    logs = _LOG_HEIGHT - np.log(seen.sigma) - 0.5 * (DEGREES + 1) * np.log1p((away / seen.sigma) ** 2 / DEGREES)
    whole = np.logaddexp(np.log(1 - OUTLIER) + logs, np.log(OUTLIER) - np.log(span))
    return np.asarray(whole.sum(axis=1))

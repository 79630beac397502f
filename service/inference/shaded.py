"""Modes refined by light and shade: the outline says where, what lies inside of it says where exactly."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from service.inference.pose import retract
from service.inference.proposal import INFLATION, Adapted, Component, Proposal, Score, temper_proposal
from service.inference.slope import Slope
from service.inference.state import Poses

SlopeAt = Callable[[Poses], Slope | None]

LEAST_SHADED = 0.02  # of the weight of the heaviest mode: lighter ones are left to their outlines


def shade(
    rng: np.random.Generator,
    parts: Sequence[Component],
    adapted: Sequence[Adapted],
    score: Score,
    exponent: float,
    between: float,
    slope_at: SlopeAt,
) -> tuple[list[Component], list[Adapted]]:
    """The modes ``parts``, each with its proposal: those that count also follow light and shade.

    ``between`` is the likelihood's power from mode to mode, ``exponent`` that within one.
    """
    pairs = list(zip(parts, adapted, strict=True))
    shares = [part.log_weight + a.log_evidence + (between - exponent) * a.peak for part, a in pairs]
    least = max(shares) + np.log(LEAST_SHADED)
    refined = [
        shade_mode(rng, *pair, score, exponent, slope_at) if share >= least else pair
        for pair, share in zip(pairs, shares, strict=True)
    ]
    return [part for part, _ in refined], [a for _, a in refined]


def shade_mode(
    rng: np.random.Generator,
    part: Component,
    adapted: Adapted,
    score: Score,
    exponent: float,
    slope_at: SlopeAt,
) -> tuple[Component, Adapted]:
    """One mode: a Gauss-Newton step from where outlines alone have brought it, then rounds of draws under both.

    Left as it was where light and shade say nothing of it, or contradict its outline so much that no draws suit both.
    """
    outline = adapted.proposal
    slope = slope_at(retract(part.mean, outline.mean[None]))
    if slope is None:
        return part, temper_proposal(rng, part, score, exponent, outline)[0]
    covariance = np.linalg.inv(np.linalg.inv(outline.factor @ outline.factor.T) + exponent * slope.curvature)
    mean = outline.mean + exponent * covariance @ slope.gradient
    shaded = replace(part, slope=slope)
    start = Proposal(mean, np.asarray(np.linalg.cholesky(INFLATION * covariance), np.float64))
    found, done = temper_proposal(rng, shaded, score, exponent, start)
    return (shaded, found) if done else (part, adapted)

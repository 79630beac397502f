"""Modes refined by light and shade: the outline says where, what lies inside of it says where exactly."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from service.inference.pose import retract
from service.inference.proposal import INFLATION, Adapted, Component, Proposal, Score, temper_proposal
from service.inference.slope import Slope
from service.inference.state import Array, Poses

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

    ``between`` is the likelihood's power from mode to mode, ``exponent`` that within one. A mode's weight stays that of
    its outline: a slope is sharper where more is seen, and says nothing of how well its best pose explains the frame.
    """
    refined: list[tuple[Component, Adapted]] = []
    pairs = list(zip(parts, adapted, strict=True))
    shares = [_share(*pair, exponent, between) for pair in pairs]
    for pair, share in zip(pairs, shares, strict=True):
        if share >= max(shares) + np.log(LEAST_SHADED):
            part, found = shade_mode(rng, *pair, score, exponent, slope_at)
            more = share - _share(part, found, exponent, between)
            pair = replace(part, log_weight=part.log_weight + more), found
        refined.append(pair)
    return [part for part, _ in refined], [found for _, found in refined]


def _share(part: Component, found: Adapted, exponent: float, between: float) -> float:
    """Log of a mode's weight, as ``mixture.posterior`` counts it."""
    return part.log_weight + found.log_evidence + (between - exponent) * found.peak


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
    factor = narrowed(outline.factor, exponent * slope.curvature)
    mean = outline.mean + exponent * factor @ (factor.T @ slope.gradient)
    shaded = replace(part, slope=slope)
    start = Proposal(mean, float(np.sqrt(INFLATION)) * factor)
    found, done = temper_proposal(rng, shaded, score, exponent, start, settled=False)
    return (shaded, found) if done else (part, adapted)


def narrowed(factor: Array, information: Array) -> Array:
    """(d, d) Cholesky factor of (C^-1 + ``information``)^-1, ``factor`` (d, d) that of C.

    As F (I + F' information F)^-1 F', whose middle is never less than the identity: with many joints C spans more
    orders of magnitude than its inverse could be taken in.
    """
    d = len(factor)
    inner = np.linalg.cholesky(np.eye(d) + factor.T @ information @ factor)
    root = np.linalg.solve(inner, factor.T)  # root' root is the covariance
    triangle = np.linalg.qr(root, mode="r")
    signs = np.where(np.diag(triangle) < 0, -1.0, 1.0)
    return np.asarray((signs[:, None] * triangle).T, np.float64)

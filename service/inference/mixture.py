"""The posterior as a sum of modes, each drawn by adaptive importance sampling.

Each mode's proposal finds its posterior (``service.inference.proposal``). The last draws, with their exact weights, are
the particles: no random walk has to find its way, and the weights' mean is the mode's evidence.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import gammaln

from service.inference.pose import concatenate, retract
from service.inference.proposal import Adapted, Component, Proposal, Score, adapt, log_density, prediction
from service.inference.shaded import SlopeAt, shade
from service.inference.slope import Slope
from service.inference.state import Array, Poses
from service.inference.weights import log_sum_exp

TAIL = 8.0  # degrees of freedom of the last draws' Student t
LEAST_PARTICLES = 40  # of a mode


@dataclass(frozen=True)
class Draws:
    """Weighted particles of one or more modes."""

    poses: Poses
    rates: Array
    log_likelihood: Array
    log_weights: Array  # (N,) not normalised: their sum is the evidence
    memory: Mapping[str, NDArray[np.generic]] = field(default_factory=dict)  # what the next frame should know
    slopes: tuple[Slope, ...] = ()  # what light and shade say near some of them


def join(a: Draws, b: Draws) -> Draws:
    """Both sets of particles as one."""
    return Draws(
        concatenate(a.poses, b.poses),
        np.concatenate([a.rates, b.rates]),
        np.concatenate([a.log_likelihood, b.log_likelihood]),
        np.concatenate([a.log_weights, b.log_weights]),
        a.memory,
        a.slopes + b.slopes,
    )


def draw(
    rng: np.random.Generator,
    part: Component,
    proposal: Proposal,
    score: Score,
    exponent: float,
    count: int,
) -> Draws:
    """``count`` particles of a mode from a Student t about the proposal, with their weights."""
    d = len(part.covariance)
    z = rng.standard_normal((count, d))
    stretch = np.sqrt(TAIL / rng.chisquare(TAIL, count))[:, None]
    x = proposal.mean + (z * stretch) @ proposal.factor.T
    poses = retract(part.mean, x)
    log_likelihood = score(poses)
    square = np.sum((z * stretch) ** 2, axis=1)
    log_t = log_t_constant(d) - 0.5 * (TAIL + d) * np.log1p(square / TAIL) - np.sum(np.log(np.diag(proposal.factor)))
    target = log_density(prediction(part), x) + exponent * (log_likelihood + part.shading(poses))
    log_weights = part.log_weight + target - log_t - np.log(count)
    rates = part.rate_mean + x @ part.rate_slope.T + rng.standard_normal((count, d)) @ part.rate_factor.T
    return Draws(poses, rates, log_likelihood, log_weights)


def log_t_constant(d: int) -> float:
    """Log constant of the d-variate Student t, less the Gaussian's -d/2 log(2 pi)."""
    return float(gammaln(0.5 * (TAIL + d)) - gammaln(0.5 * TAIL) - 0.5 * d * np.log(TAIL / 2))


def posterior(
    rng: np.random.Generator,
    parts: Sequence[Component],
    score: Score,
    exponent: float,
    count: int,
    between: float | None = None,
    slope_at: SlopeAt | None = None,
) -> Draws:
    """``count`` weighted particles over all modes, shared out by the modes' evidence.

    Within a mode the likelihood counts with the power ``exponent``, from mode to mode with ``between`` (the same by
    default): nearby poses share what the model gets wrong, shadow and glare, and far ones do not. Under a mode's peak
    L_k a pose has the weight (L / L_k)^exponent L_k^between. So the evidence counts by ``between`` too, and can be held
    against that of another model whatever exponent each was found with.
    """
    adapted = [adapt(rng, part, score, exponent, settled=slope_at is None) for part in parts]
    if slope_at is not None:
        parts, adapted = shade(rng, parts, adapted, score, exponent, exponent if between is None else between, slope_at)
    peaks = np.array([a.peak for a in adapted])
    even = ((exponent if between is None else between) - exponent) * peaks
    log_shares = even + [part.log_weight + a.log_evidence for part, a in zip(parts, adapted, strict=True)]
    counts = share_out(np.exp(log_shares - log_sum_exp(log_shares)), count)
    draws = [
        draw(rng, replace(part, log_weight=part.log_weight + float(more)), a.proposal, score, exponent, int(n))
        for part, a, more, n in zip(parts, adapted, even, counts, strict=True)
        if n > 0
    ]
    return Draws(
        concatenate(*(d.poses for d in draws)),
        np.concatenate([d.rates for d in draws]),
        np.concatenate([d.log_likelihood for d in draws]),
        np.concatenate([d.log_weights for d in draws]),
        {"surprise": surprise_of(parts, adapted, log_shares)},
        tuple(part.slope for part in parts if part.slope is not None),
    )


def surprise_of(parts: Sequence[Component], adapted: Sequence[Adapted], log_shares: Array) -> NDArray[np.float64]:
    """How far the heaviest mode ended from its prediction: mean square per coordinate, in predicted variances.

    Doubled, because the frame and the prediction decide about half each: 1 is what is to be expected.
    """
    top = int(np.argmax(log_shares))
    z = np.linalg.solve(prediction(parts[top]).factor, adapted[top].proposal.mean)
    return np.asarray(2.0 * np.mean(z * z), dtype=np.float64)


def share_out(shares: Array, count: int) -> NDArray[np.intp]:
    """(K,) whole numbers that sum to ``count``, about as ``shares``; a small mode gets ``LEAST_PARTICLES``."""
    least = min(LEAST_PARTICLES, count // len(shares))
    counts = least + np.floor(shares * (count - least * len(shares))).astype(np.intp)
    counts[int(np.argmax(shares))] += count - counts.sum()
    return np.asarray(counts, dtype=np.intp)

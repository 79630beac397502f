"""The posterior as a sum of modes, each drawn by adaptive importance sampling.

Every mode is predicted as a Gaussian in the tangent space of its mean, poses and rates together (Kotecha and Djuric,
*Gaussian sum particle filtering*, 2003). A few rounds of draws move a proposal from the prediction onto
prediction x likelihood^beta, beta as large as a target effective sample size allows (Cappe et al., *Population Monte
Carlo*, 2004; Bugallo et al., *Adaptive importance sampling*, 2017). The last draws, with their exact weights, are the
particles: no random walk has to find its way, and the weights' mean is the mode's evidence.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import gammaln

from service.inference.modes import Metric, short_way
from service.inference.pose import concatenate, local, retract
from service.inference.state import Array, Poses
from service.inference.weights import effective_sample_size, log_sum_exp, normalise

Score = Callable[[Poses], Array]

ROUND_DRAWS = 150
MOST_ROUNDS = 10  # of tempering before and after a climb
CLIMB_ROUNDS = 12
MOST_CLIMBS = 3
ROUND_ESS = 0.25  # of a round's draws
INFLATION = 1.3  # of the proposal's covariance, so that its tails are not lighter than the target's
TAIL = 8.0  # degrees of freedom of the last draws' Student t
LEAST_PARTICLES = 40  # of a mode
_LADDER = 0.75 ** np.arange(40.0)  # exponents tried, as shares of the last


@dataclass(frozen=True)
class Component:
    """One mode's prediction: pose Gaussian about ``mean``, the rate given the pose Gaussian too."""

    log_weight: float
    mean: Poses  # one
    covariance: Array  # (d, d) tangent space at ``mean``
    rate_mean: Array  # (d,)
    rate_slope: Array  # (d, d): expected rate at x is rate_mean + rate_slope x
    rate_factor: Array  # (d, d): A of the conditional covariance A A^T


@dataclass(frozen=True)
class Draws:
    """Weighted particles of one or more modes."""

    poses: Poses
    rates: Array
    log_likelihood: Array
    log_weights: Array  # (N,) not normalised: their sum is the evidence
    memory: Mapping[str, NDArray[np.generic]] = field(default_factory=dict)  # what the next frame should know


def join(a: Draws, b: Draws) -> Draws:
    """Both sets of particles as one."""
    return Draws(
        concatenate(a.poses, b.poses),
        np.concatenate([a.rates, b.rates]),
        np.concatenate([a.log_likelihood, b.log_likelihood]),
        np.concatenate([a.log_weights, b.log_weights]),
        a.memory,
    )


def component(
    poses: Poses,
    rates: Array,
    weights: Array,
    origin: Poses,
    metric: Metric,
    log_weight: float,
    least: Array,
    carried: Array | float = 0.0,
    stepped: Array | float = 0.0,
) -> Component:
    """The Gaussian of predicted (poses, rates), weights summing to 1.

    To their covariance is added: ``least`` (d,), squared, of the pose; ``stepped`` (d,) of the rate; ``carried`` (d,)
    between both, since a rate's own random steps move the pose along.
    """
    x = short_way(local(origin, poses), metric)
    centre = weights @ x
    mean = retract(origin, centre[None])
    x = x - centre
    v = rates - weights @ rates
    covariance = np.einsum("n,ni,nj->ij", weights, x, x) + np.diag(least**2)
    both = np.einsum("n,ni,nj->ij", weights, x, v) + carried * np.eye(len(centre))
    slope = np.linalg.solve(covariance, both).T
    spread = np.einsum("n,ni,nj->ij", weights, v, v) + stepped * np.eye(len(centre))
    rest = spread - slope @ covariance @ slope.T
    return Component(log_weight, mean, covariance, weights @ rates, slope, _factor(rest))


def _factor(covariance: Array) -> Array:
    """A with A A^T the nearest positive semi-definite matrix to ``covariance``."""
    values, vectors = np.linalg.eigh(0.5 * (covariance + covariance.T))
    return np.asarray(vectors * np.sqrt(np.maximum(values, 0.0)))


@dataclass(frozen=True)
class Proposal:
    """Where a mode's draws come from: tangent space of the component's mean."""

    mean: Array  # (d,)
    factor: Array  # (d, d) Cholesky factor


@dataclass(frozen=True)
class Adapted:
    """A proposal that has found the posterior."""

    proposal: Proposal
    log_evidence: float  # as the last round of draws sees it
    peak: float  # greatest log likelihood met


def adapt(rng: np.random.Generator, part: Component, score: Score, exponent: float) -> Adapted:
    """Move the proposal from the prediction onto the posterior.

    Where tempering comes to a halt, because nearly all of the prediction scores alike and the peak is a needle in it,
    the best draws of some rounds lead to the peak by their ranks alone (a cross-entropy search), and it starts anew;
    again where that was not near enough.
    """
    prior = prediction(part)
    adapted, done = temper_proposal(rng, part, score, exponent, prior)
    for _ in range(MOST_CLIMBS):
        if done:
            break
        proposal = climb(rng, part, score, exponent, adapted.proposal)
        adapted, done = temper_proposal(rng, part, score, exponent, proposal)
    return adapted


def temper_proposal(
    rng: np.random.Generator, part: Component, score: Score, exponent: float, proposal: Proposal
) -> tuple[Adapted, bool]:
    """Rounds of draws with a rising exponent; whether the full one was reached."""
    prior, previous, adapted = prediction(part), 0.0, Adapted(proposal, 0.0, -np.inf)
    for _ in range(MOST_ROUNDS):
        x, log_likelihood = try_out(rng, part, score, proposal)
        base = log_density(prior, x) - log_density(proposal, x)
        beta = steepest_exponent(base, log_likelihood, exponent)
        weights = np.exp(normalise(base + beta * log_likelihood)[0])
        log_evidence = log_sum_exp(base + exponent * log_likelihood) - float(np.log(len(x)))
        mean = weights @ x
        covariance = INFLATION * np.einsum("n,ni,nj->ij", weights, x - mean, x - mean)
        # Few effective draws underestimate the width in some direction: keep a little of the old one.
        covariance += 0.05 * proposal.factor @ proposal.factor.T + 1e-9 * part.covariance
        proposal = Proposal(mean, np.asarray(np.linalg.cholesky(covariance), dtype=np.float64))
        adapted = Adapted(proposal, log_evidence, max(adapted.peak, float(log_likelihood.max())))
        if beta >= exponent and previous >= exponent:
            return adapted, True
        previous = beta
    return adapted, False


def try_out(rng: np.random.Generator, part: Component, score: Score, proposal: Proposal) -> tuple[Array, Array]:
    """A round of draws (N, d) and what they score (N,)."""
    x = proposal.mean + rng.standard_normal((ROUND_DRAWS, len(proposal.mean))) @ proposal.factor.T
    return x, score(retract(part.mean, x))


def climb(rng: np.random.Generator, part: Component, score: Score, exponent: float, proposal: Proposal) -> Proposal:
    """A cross-entropy search for the posterior's peak; the widest of its proposals whose draws are near the peak.

    Draws of a Gaussian k times as wide as the posterior lie k^2 d / 2 below the peak.
    """
    prior, d = prediction(part), len(proposal.mean)
    peak, tried = -np.inf, []
    for _ in range(CLIMB_ROUNDS):
        x, log_likelihood = try_out(rng, part, score, proposal)
        target = log_density(prior, x) + exponent * log_likelihood
        peak = max(peak, float(target.max()))
        tried.append((float(np.median(target)), proposal))
        best = x[np.argsort(-target)[: ROUND_DRAWS // 4]]
        mean = best.mean(axis=0)
        covariance = np.einsum("ni,nj->ij", best - mean, best - mean) / len(best)
        covariance += 0.05 * proposal.factor @ proposal.factor.T + 1e-9 * part.covariance
        proposal = Proposal(mean, np.asarray(np.linalg.cholesky(covariance), dtype=np.float64))
    return next((wide for median, wide in tried if median > peak - 2 * d), proposal)


def steepest_exponent(base: Array, log_likelihood: Array, exponent: float) -> float:
    """The largest beta of a falling ladder for which enough of a round's draws count, else the one with most.

    A ladder and not a root: the proposal was made for some beta of the round before, so the effective sample size
    rises towards that beta and falls beyond it.
    """
    ladder = exponent * _LADDER
    sizes = [effective_sample_size(base + beta * log_likelihood) / len(base) for beta in ladder]
    enough = [beta for beta, size in zip(ladder, sizes, strict=True) if size >= ROUND_ESS]
    return float(enough[0] if enough else ladder[int(np.argmax(sizes))])


def prediction(part: Component) -> Proposal:
    """The mode's own prediction as a proposal."""
    factor = np.asarray(np.linalg.cholesky(part.covariance), dtype=np.float64)
    return Proposal(np.zeros(len(part.covariance)), factor)


def log_density(gaussian: Proposal, x: Array) -> Array:
    """(N,) log density of a Gaussian, less the constant -d/2 log(2 pi) that all here share."""
    z = np.linalg.solve(gaussian.factor, (x - gaussian.mean).T)
    return np.asarray(-0.5 * np.sum(z * z, axis=0) - np.sum(np.log(np.diag(gaussian.factor))))


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
    log_weights = part.log_weight + log_density(prediction(part), x) + exponent * log_likelihood - log_t - np.log(count)
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
) -> Draws:
    """``count`` weighted particles over all modes, shared out by the modes' evidence.

    Within a mode the likelihood counts with the power ``exponent``, from mode to mode with ``between`` (the same by
    default): nearby poses share what the model gets wrong, shadow and glare, and far ones do not. Under a mode's peak
    L_k a pose has the weight (L / L_k)^exponent L_k^between. So the evidence counts by ``between`` too, and can be held
    against that of another model whatever exponent each was found with.
    """
    adapted = [adapt(rng, part, score, exponent) for part in parts]
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

"""One mode's proposal, moved from its prediction onto its posterior in a few rounds of draws.

A mode is predicted as a Gaussian in the tangent space of its mean, poses and rates together (Kotecha and Djuric,
*Gaussian sum particle filtering*, 2003). Rounds of draws move a proposal from the prediction onto prediction x
likelihood^beta, beta as large as a target effective sample size allows (Cappe et al., *Population Monte Carlo*, 2004;
Bugallo et al., *Adaptive importance sampling*, 2017).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from service.inference.modes import Metric, short_way
from service.inference.pose import local, retract
from service.inference.slope import Slope
from service.inference.state import Array, Poses
from service.inference.weights import log_sum_exp, normalise

Score = Callable[[Poses], Array]

ROUND_DRAWS = 150  # of a mode, or
DRAWS_PER_COORDINATE = 15  # if those are more: fewer could not tell the covariance of a body of many joints
MOST_ROUNDS = 10  # of tempering before and after a climb
CLIMB_ROUNDS = 12
MOST_CLIMBS = 3
ROUND_ESS = 0.25  # of a round's draws
INFLATION = 1.3  # of the proposal's covariance, so that its tails are not lighter than the target's
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
    slope: Slope | None = None  # what light and shade say of its poses

    def shading(self, poses: Poses) -> Array | float:
        """(N,) nats by which light and shade speak for poses of this mode."""
        return 0.0 if self.slope is None else self.slope(poses)


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


def adapt(rng: np.random.Generator, part: Component, score: Score, exponent: float, settled: bool = True) -> Adapted:
    """Move the proposal from the prediction onto the posterior; not ``settled``, about onto it.

    Where tempering comes to a halt, because nearly all of the prediction scores alike and the peak is a needle in it,
    the best draws of some rounds lead to the peak by their ranks alone (a cross-entropy search), and it starts anew;
    again where that was not near enough.
    """
    prior = prediction(part)
    adapted, done = temper_proposal(rng, part, score, exponent, prior, settled)
    for _ in range(MOST_CLIMBS):
        if done:
            break
        proposal = climb(rng, part, score, exponent, adapted.proposal)
        adapted, done = temper_proposal(rng, part, score, exponent, proposal, settled)
    return adapted


def temper_proposal(
    rng: np.random.Generator,
    part: Component,
    score: Score,
    exponent: float,
    proposal: Proposal,
    settled: bool = True,
) -> tuple[Adapted, bool]:
    """Rounds of draws with a rising exponent; whether the full one was reached, ``settled`` in two rounds running."""
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
        if beta >= exponent and (previous >= exponent or not settled):
            return adapted, True
        previous = beta
    return adapted, False


def try_out(rng: np.random.Generator, part: Component, score: Score, proposal: Proposal) -> tuple[Array, Array]:
    """A round of draws (N, d) and what they score (N,)."""
    d = len(proposal.mean)
    x = proposal.mean + rng.standard_normal((max(ROUND_DRAWS, DRAWS_PER_COORDINATE * d), d)) @ proposal.factor.T
    poses = retract(part.mean, x)
    return x, score(poses) + part.shading(poses)


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
        best = x[np.argsort(-target)[: len(x) // 4]]
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
    log_weights = base + ladder[:, None] * log_likelihood
    weights = np.exp(log_weights - np.max(log_weights, axis=1, keepdims=True))
    sizes = np.sum(weights, axis=1) ** 2 / np.sum(weights**2, axis=1)
    enough = np.flatnonzero(sizes >= ROUND_ESS * len(base))
    return float(ladder[enough[0] if len(enough) else int(np.argmax(sizes))])


def prediction(part: Component) -> Proposal:
    """The mode's own prediction as a proposal."""
    factor = np.asarray(np.linalg.cholesky(part.covariance), dtype=np.float64)
    return Proposal(np.zeros(len(part.covariance)), factor)


def log_density(gaussian: Proposal, x: Array) -> Array:
    """(N,) log density of a Gaussian, less the constant -d/2 log(2 pi) that all here share."""
    z = np.linalg.solve(gaussian.factor, (x - gaussian.mean).T)
    return np.asarray(-0.5 * np.sum(z * z, axis=0) - np.sum(np.log(np.diag(gaussian.factor))))

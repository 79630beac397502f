"""A frame's likelihood approached in steps: reweigh, resample, move (Del Moral, Doucet, Jasra 2006).

With L^beta for beta from 0 to the likelihood's exponent, each step as large as the effective sample size allows,
the particles are drawn towards the peak instead of one of them being picked by luck. Moves are Metropolis steps
whose covariance is that of the particle's own cluster, so they shrink with the population and never mix modes.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from service.inference.islands import pick
from service.inference.modes import Labels, Metric, find_seeds, nearest_seed, short_way
from service.inference.pose import concatenate, local, retract
from service.inference.resample import RESAMPLERS
from service.inference.state import Array, Poses
from service.inference.weights import log_sum_exp, next_exponent, normalise

MOST_STEPS = 100

Score = Callable[[Poses], Array]


@dataclass(frozen=True)
class Population:
    """Particles with what is known of each: its likelihood and its place in the prediction."""

    poses: Poses
    log_likelihood: Array  # (N,) log of Eq. 4's particle term
    centre: Poses | None  # prediction each particle was drawn around; None: the prior is flat
    rates: Array  # (N, 6 + J) carried along

    def __getitem__(self, index: np.ndarray) -> Population:
        centre = None if self.centre is None else self.centre[index]
        return Population(self.poses[index], self.log_likelihood[index], centre, self.rates[index])


def join(a: Population, b: Population) -> Population:
    """Both populations as one; neither then has a prediction of its own."""
    return Population(
        concatenate(a.poses, b.poses),
        np.concatenate([a.log_likelihood, b.log_likelihood]),
        None,
        np.concatenate([a.rates, b.rates]),
    )


@dataclass(frozen=True)
class Tempering:
    """How to approach the likelihood."""

    exponent: float  # where beta ends
    start: float = field(default=0.0, kw_only=True)  # where beta begins
    target_ess: float
    moves: int  # least number of steps
    resampler: str
    deviation: Array  # (6 + J,) of the prediction; also the greatest standard deviation of a move
    metric: Metric


def temper(
    rng: np.random.Generator,
    population: Population,
    score: Score,
    inside: Callable[[Poses], np.ndarray],
    plan: Tempering,
    count: int,
) -> tuple[Population, float, int]:
    """Run the steps; returns ``count`` equally weighted particles, the log evidence and the number of moves."""
    beta, log_evidence, step = plan.start, 0.0, 0
    while beta < plan.exponent or step < plan.moves:
        n = len(population.log_likelihood)
        uniform = np.full(n, -np.log(n))
        new_beta = next_exponent(uniform, population.log_likelihood, beta, plan.exponent, plan.target_ess)
        if step >= MOST_STEPS:  # a likelihood without end: better an uneven population than none
            new_beta = plan.exponent
        if new_beta > beta or n != count:
            log_weights = uniform + (new_beta - beta) * population.log_likelihood
            log_evidence += log_sum_exp(log_weights)
            population = population[RESAMPLERS[plan.resampler](rng, normalise(log_weights)[0], count)]
        beta = new_beta
        population = move(rng, population, score, inside, plan, beta)
        step += 1
    return population, log_evidence, step


def move(
    rng: np.random.Generator,
    population: Population,
    score: Score,
    inside: Callable[[Poses], np.ndarray],
    plan: Tempering,
    beta: float,
) -> Population:
    """One Metropolis step for every particle; leaves prior x L^beta unchanged.

    A step has the covariance of the particle's cluster, taken from the half of the population that the particle is
    not in. A step into another cluster is not made: the way back would have another covariance.
    """
    poses = population.poses
    n, d = len(poses), len(plan.deviation)
    seeds = find_seeds(poses, population.log_likelihood, plan.metric)
    labels = nearest_seed(poses, seeds, plan.metric)
    half = np.arange(n) % 2
    factors = [cluster_factors(poses, labels, half != h, len(seeds), plan) for h in (0, 1)]
    stride = 2.38 / np.sqrt(d) * np.exp(0.7 * rng.standard_normal((n, 1)) - 0.5)
    z = rng.standard_normal((n, d)) * stride
    proposal = retract(poses, np.einsum("nij,nj->ni", np.stack(factors)[half, labels], z))
    allowed = inside(proposal) & (nearest_seed(proposal, seeds, plan.metric) == labels)
    log_likelihood = np.where(allowed, score(proposal), -np.inf)
    log_ratio = beta * (log_likelihood - population.log_likelihood) if beta > 0 else np.where(allowed, 0.0, -np.inf)
    if population.centre is not None:
        log_ratio += log_prediction(population.centre, proposal, plan.deviation)
        log_ratio -= log_prediction(population.centre, poses, plan.deviation)
    accept = np.log(rng.random(n)) < log_ratio
    chosen = np.where(accept, log_likelihood, population.log_likelihood)
    return Population(pick(accept, proposal, poses), chosen, population.centre, population.rates)


def log_prediction(centre: Poses, poses: Poses, deviation: Array) -> Array:
    """(N,) log density (up to a constant) of poses about their predictions."""
    z = local(centre, poses) / deviation
    return np.asarray(-0.5 * np.sum(z * z, axis=1))


def cluster_factors(
    poses: Poses, labels: Labels, counted: NDArray[np.bool_], n_clusters: int, plan: Tempering
) -> Array:
    """(K, d, d) factor A of each cluster's covariance A A^T in tangent coordinates, from the ``counted`` poses.

    A cluster of few particles has no covariance of its own: it is shrunk towards the pooled one.
    """
    d = len(plan.deviation)
    members = [np.flatnonzero(counted & (labels == k)) for k in range(n_clusters)]
    counts = np.array([len(m) for m in members], dtype=np.float64)
    spreads = np.stack([_spread(poses[m], plan.metric) for m in members])
    pooled = np.einsum("k,kij->ij", counts, spreads) / max(1.0, counts.sum())
    share = (counts / (counts + 2.0 * d))[:, None, None]
    covariance = share * spreads + (1 - share) * pooled + np.diag((1e-4 * plan.deviation) ** 2)
    limit = np.minimum(1.0, plan.deviation / np.sqrt(np.einsum("kii->ki", covariance)))
    return np.linalg.cholesky(covariance * limit[:, :, None] * limit[:, None, :])


def _spread(poses: Poses, metric: Metric) -> Array:
    """(d, d) covariance of poses in the tangent space at the first of them."""
    d = 6 + poses.joints.shape[1]
    if len(poses) < 2:
        return np.zeros((d, d))
    x = short_way(local(poses[:1], poses), metric)
    x = x - x.mean(axis=0)
    return np.asarray(x.T @ x / (len(x) - 1))

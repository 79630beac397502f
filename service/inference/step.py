"""The published filter: a frame's measurement in, the weighted posterior out."""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

import numpy as np

from service.inference.domain import Domain, sample_prior
from service.inference.estimate import summarise
from service.inference.motion import diffusion, propagate
from service.inference.params import SessionConfig
from service.inference.pose import pick
from service.inference.resample import RESAMPLERS
from service.inference.state import Array, Estimate, FilterState, Frame, Outcome, Poses
from service.inference.weights import normalise

Score = Callable[[Poses], Array]


class Bootstrap(Protocol):
    """A way to make the paper's update: see ``bootstrap_update``."""

    def __call__(
        self,
        rng: np.random.Generator,
        state: FilterState | None,
        frame: Frame,
        score: Score,
        config: SessionConfig,
        domain: Domain,
    ) -> Outcome:
        """The posterior after a frame."""


def step(
    rng: np.random.Generator,
    state: FilterState | None,
    frame: Frame,
    score: Score,
    config: SessionConfig,
    domain: Domain,
    bootstrap: Bootstrap | None = None,
) -> tuple[FilterState, Estimate]:
    """Update ``state`` (None before the first frame) by one frame.

    ``score(poses)`` sums log c under each silhouette: (N,), the per-particle term of Eq. 4. ``bootstrap`` makes the
    update; by default ``bootstrap_update`` does.
    """
    outcome = (bootstrap or bootstrap_update)(rng, state, frame, score, config, domain)
    estimate = summarise(outcome, frame.measurement.log_background, domain)
    return FilterState(
        outcome.poses, outcome.log_weights, outcome.rates, frame.index, frame.time_s, outcome.status
    ), estimate


def bootstrap_update(
    rng: np.random.Generator,
    state: FilterState | None,
    frame: Frame,
    score: Score,
    config: SessionConfig,
    domain: Domain,
) -> Outcome:
    """The paper's filter: resample (Eq. 6), move each particle by a random jitter, weigh by the likelihood (Eq. 4).

    Before the first frame the particles are drawn from the uniform prior. A jitter that would leave it is not made.
    """
    count = config.filter.particles
    if state is None:
        poses = sample_prior(rng, domain, count)
    else:
        ancestors = RESAMPLERS[config.filter.resampler](rng, state.log_weights, count)
        before = state.poses[ancestors]
        dt_s = max(frame.time_s - state.time_s, 0.0)
        moved = domain.wrap(propagate(rng, before, diffusion(config.motion, domain) * np.sqrt(dt_s)))
        poses = pick(domain.stays(moved, before), moved, before)
    return weighed(poses, score(poses), domain)


def weighed(poses: Poses, log_likelihood: Array, domain: Domain) -> Outcome:
    """Particles of equal weight, weighed by their likelihood (Eq. 4); ``log_likelihood`` is (N,)."""
    log_weights, total = normalise(log_likelihood)
    return Outcome(
        poses=poses,
        log_weights=log_weights,
        log_likelihood=log_likelihood,
        rates=np.zeros((len(poses), domain.n_tangent)),
        status="tracking" if float(np.max(log_likelihood)) > 0 else "no_target",
        log_evidence=total - float(np.log(len(poses))),
    )

"""One update of the filter: a frame's measurement in, the weighted posterior out."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from service.inference.domain import Domain, sample_prior
from service.inference.estimate import summarise
from service.inference.islands import pick
from service.inference.motion import diffusion, propagate
from service.inference.params import SessionConfig
from service.inference.resample import RESAMPLERS
from service.inference.sample_size import adapted
from service.inference.state import Array, Estimate, FilterState, Frame, Outcome, Poses
from service.inference.symmetry import Symmetry, refold, unfold
from service.inference.tracking import track
from service.inference.update import Shade
from service.inference.weights import normalise

ScoreMaps = Callable[[Poses, NDArray[np.float32]], Array]


class Bootstrap(Protocol):
    """A way to make the paper's update: see ``bootstrap_update``."""

    def __call__(
        self,
        rng: np.random.Generator,
        state: FilterState | None,
        frame: Frame,
        score: Callable[[Poses], Array],
        config: SessionConfig,
        domain: Domain,
    ) -> Outcome:
        """The posterior after a frame."""


def step(
    rng: np.random.Generator,
    state: FilterState | None,
    frame: Frame,
    score_maps: ScoreMaps,
    config: SessionConfig,
    domain: Domain,
    twins: Sequence[Symmetry] = (),
    bootstrap: Bootstrap | None = None,
    shade: Shade | None = None,
) -> tuple[FilterState, Estimate]:
    """Update ``state`` (None before the first frame) by one frame; ``twins`` are the body's symmetries.

    ``bootstrap`` makes the paper's update where the method is that; by default ``bootstrap_update`` does.
    ``score_maps(poses, maps)`` sums each of (K, H, W) maps under each silhouette: (N, K), the per-particle term of
    Eq. 4 when the map is log c.
    """
    if bootstrap is None:  # what stays on a device keeps its number
        config = adapted(config, state, domain)
    log_ratio = frame.measurement.log_ratio[None]

    def score(poses: Poses) -> Array:
        return score_maps(poses, log_ratio)[:, 0]

    if config.filter.method == "bootstrap":
        update = bootstrap or bootstrap_update
        outcome, twins = update(rng, state, frame, score, config, domain), ()
    else:
        outcome = track(rng, one_of_twins(state, twins, domain), frame, score_maps, config, domain, twins, shade)
    estimate = summarise(outcome, frame.measurement.log_background, twins, domain)
    poses, rates = unfold(outcome.poses, outcome.rates, twins, domain)
    new_state = FilterState(
        poses, outcome.log_weights, rates, frame.index, frame.time_s, outcome.status, outcome.memory
    )
    return new_state, estimate


def one_of_twins(state: FilterState | None, twins: Sequence[Symmetry], domain: Domain) -> FilterState | None:
    """The state with every particle on one side of the twins.

    No silhouette tells twins apart, so one of them is tracked; all are stored and reported.
    """
    if state is None or not twins:
        return state
    poses, rates = refold(state.poses, state.rates, twins, domain)
    return replace(state, poses=poses, rates=rates)


def bootstrap_update(
    rng: np.random.Generator,
    state: FilterState | None,
    frame: Frame,
    score: Callable[[Poses], Array],
    config: SessionConfig,
    domain: Domain,
) -> Outcome:
    """The paper's filter: resample (Eq. 6), move each particle by a random jitter, weigh by the likelihood (Eq. 4).

    Before the first frame the particles are drawn from the uniform prior. A jitter that would leave the prior's
    bounds is not made.
    """
    count = config.filter.particles
    if state is None:
        poses = sample_prior(rng, domain, count)
    else:
        ancestors = RESAMPLERS[config.filter.resampler](rng, state.log_weights, count)
        before = state.poses[ancestors]
        dt_s = max(frame.time_s - state.time_s, 0.0)
        moved = domain.wrap(propagate(rng, before, diffusion(config.motion, domain) * np.sqrt(dt_s)))
        poses = pick(domain.contains(moved), moved, before)
    return weighed(poses, score(poses), config, domain)


def weighed(poses: Poses, log_likelihood: Array, config: SessionConfig, domain: Domain) -> Outcome:
    """Particles of equal weight, weighed by their likelihood (Eq. 4); ``log_likelihood`` is (N,)."""
    log_weights, total = normalise(config.likelihood.exponent * log_likelihood)
    return Outcome(
        poses=poses,
        log_weights=log_weights,
        log_likelihood=log_likelihood,
        rates=np.zeros((len(poses), domain.n_tangent)),
        status="tracking" if float(np.max(log_likelihood)) > 0 else "no_target",
        log_evidence=total - float(np.log(len(poses))),
        memory={},
    )

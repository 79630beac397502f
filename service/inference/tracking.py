"""The default update: follow or search, and know whether the image supports the result."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from service.inference.acquisition import Evidence, find_evidence, place
from service.inference.domain import Domain
from service.inference.mixture import Draws, join, posterior
from service.inference.modes import LEAST_MODE, MOST_MODES, cluster, distance
from service.inference.motion import carry_on
from service.inference.params import SessionConfig
from service.inference.peak import best_pose, heading, likeliest_twin
from service.inference.pose import retract
from service.inference.proposal import Component, component
from service.inference.resample import RESAMPLERS
from service.inference.search import island_components, log_occam, search_islands, search_reach
from service.inference.state import Array, FilterState, Frame, Outcome, Poses
from service.inference.symmetry import Symmetry
from service.inference.update import ScoreMaps, Shade, Update
from service.inference.weights import normalise

ESTABLISHED_FRAMES = 3  # frames of support in a row before a track is called one
SUPPORT_FLOOR = 0.3  # share of the frame's light that the best silhouette must explain
SUPPORT_DROP = 0.6  # of the track's own usual support; below it the whole space is searched again
LEAST_GAIN = 0.02  # of what the track's silhouettes usually gain on empty sky: less is a star, not the object
FADE = 0.85  # of the running averages, per frame
RENEW_FRAMES = 10  # a track is held against a search of the whole space this often
NEWCOMER = 0.01  # prior weight of what a renewed search finds beside a track


def track(
    rng: np.random.Generator,
    state: FilterState | None,
    frame: Frame,
    score_maps: ScoreMaps,
    config: SessionConfig,
    domain: Domain,
    twins: Sequence[Symmetry] = (),
    shade: Shade | None = None,
) -> Outcome:
    """One frame of the default filter.

    Follows the modes there are. Searches the whole space where there are none, where the track is not yet
    established, where the image does not support it any more, and now and then in any case: a wrong mode can explain
    the first frames as well as the right one. What a search finds elsewhere stands beside the track with the weight
    that its evidence gives it.
    """
    update = Update(rng, state, frame, score_maps, config, domain, twins, shade)
    evidence = find_evidence(frame.measurement.log_ratio)
    if evidence is None:
        return unseen(update)
    known = float(update.recall("age", 0.0)) > 0
    established = state is not None and state.status == "tracking"
    draws = follow(update) if known else None
    renew = known and renewal_due(float(update.recall("age", 0.0)))
    if draws is None or not established or renew or not supported(update, draws):
        glance = draws is not None and established and supported(update, draws)
        draws = likeliest_twin(update, search(update, evidence, draws, glance))
    if float(np.max(draws.log_likelihood)) <= LEAST_GAIN * float(update.recall("gain", 0.0)):
        return unseen(update)
    return conclude(update, draws, evidence)


def renewal_due(age: float) -> bool:
    """Whether a track of ``age`` frames is held against a search of the whole space in the next one."""
    return age % RENEW_FRAMES == 0


def follow(update: Update) -> Draws:
    """Carry every mode on by its rates and weigh it by the frame."""
    draws = mixture_posterior(update, predicted_components(update), update.exponent())
    return replace(draws, memory={"surprise": lately(update, "surprise", float(draws.memory["surprise"]), 1.0)})


def lately(update: Update, name: str, now: float, before: float | None = None) -> Array:
    """() running average of what memory keeps by ``name``; it begins at ``before``, or else at ``now``."""
    usual = float(update.recall(name, now if before is None else before))
    return np.array(FADE * usual + (1 - FADE) * now)


def mixture_posterior(update: Update, parts: list[Component], exponent: float) -> Draws:
    """Weighted particles of the modes ``parts`` under this frame."""
    between, count = update.config.likelihood.mode_exponent, update.config.filter.particles
    return posterior(update.rng, parts, update.score, exponent, count, between, update.slope)


def predicted_components(update: Update) -> list[Component]:
    """The modes of the last posterior, each carried on by its rates and widened by the motion's diffusion."""
    state = update.state
    assert state is not None, "there is a track to follow"
    dt_s, motion = update.dt_s, update.rates
    labels = cluster(state.poses, state.log_weights, update.metric)
    weights = np.exp(state.log_weights)
    share = np.bincount(labels, weights=weights)
    jitter = np.sqrt(motion.jitter * dt_s + motion.change * dt_s**3 / 3) * update.surprise
    carried = motion.change * dt_s**2 / 2
    parts = []
    for k in np.argsort(-share)[:MOST_MODES]:
        members = np.flatnonzero(labels == k)
        if share[k] < LEAST_MODE:
            continue
        inner = weights[members] / share[k]
        poses, rates = state.poses[members], state.rates[members]
        origin = carry_on(poses[:1], rates[:1], dt_s)
        log_weight = float(np.log(share[k]))
        moved = carry_on(poses, rates, dt_s)
        stepped = motion.change * dt_s
        parts.append(component(moved, rates, inner, origin, update.metric, log_weight, jitter, carried, stepped))
    return parts


def search(update: Update, evidence: Evidence, tracked: Draws | None, glance: bool) -> Draws:
    """The whole space; beside ``tracked``, only what lies elsewhere."""
    top = 0 if tracked is None else int(np.argmax(tracked.log_likelihood))
    anchor = None if tracked is None else tracked.poses[top : top + 1]
    islands = search_islands(update, evidence, anchor, glance)
    if tracked is None:
        parts = island_components(update, islands, log_occam(update, len(islands)))
        exponent = update.exponent(update.misfit(evidence, islands.best, islands.log_likelihood))
        return replace(mixture_posterior(update, parts, exponent), memory={})
    away = distance(islands.best, tracked.poses[top : top + 1], update.metric) > 1.0
    if not np.any(away):
        return tracked
    elsewhere = islands[np.flatnonzero(away)]
    even = even_start(update)
    beside = float(update.shading(tracked.poses[top : top + 1])[0])
    newcomers = island_components(update, elsewhere, float(np.log(NEWCOMER)) + even, beside)
    found = mixture_posterior(update, newcomers, update.exponent())
    both = join(tracked, found)
    pick = RESAMPLERS[update.config.filter.resampler](
        update.rng, normalise(both.log_weights)[0], update.config.filter.particles
    )
    # The newcomers' weight is the filter's choice; as evidence they count for what the whole space gives them.
    known, new = (
        normalise(tracked.log_weights)[1],
        normalise(found.log_weights)[1] - even + log_occam(update, len(elsewhere)),
    )
    total = float(np.logaddexp(known, new)) - float(np.log(len(pick)))
    equal = np.full(len(pick), total)
    return Draws(both.poses[pick], both.rates[pick], both.log_likelihood[pick], equal, {}, both.slopes)


def even_start(update: Update) -> float:
    """Log of how much narrower the track's prediction is than the reach that a newcomer is searched in.

    The track was as wide when it was found. Without this the frames that have narrowed it since would count for it
    a second time, and a newcomer with the better silhouette could hardly ever take its place.
    """
    track = predicted_components(update)[0].covariance
    reach = search_reach(update.domain)
    return max(0.0, float(np.sum(np.log(reach)) - 0.5 * np.linalg.slogdet(track)[1]))


def supported(update: Update, draws: Draws) -> bool:
    """Whether the best silhouette explains as much of the light as it should, and as it used to."""
    usual = float(update.recall("support", 0.0))
    return support(update, draws) >= max(SUPPORT_FLOOR, SUPPORT_DROP * usual)


def support(update: Update, draws: Draws) -> float:
    """Share of the frame's light that the best silhouette explains, less what it covers in vain."""
    return float(np.max(draws.log_likelihood)) / max(update.light, 1e-9)


def unseen(update: Update) -> Outcome:
    """No object in the image: the posterior is the prediction, which widens until it is seen again."""
    state, domain, count = update.state, update.domain, update.config.filter.particles
    memory: dict[str, NDArray[np.generic]] = {} if state is None else dict(state.memory)
    if state is not None and float(update.recall("age", 0.0)) > 0:
        motion = update.rates
        shape, dt_s = (len(state.poses), domain.n_tangent), update.dt_s
        turn = update.rng.standard_normal(shape) * np.sqrt(motion.change * dt_s)
        rest = np.sqrt(motion.jitter * dt_s + motion.change * dt_s**3 / 12)  # beside what the rate's step has done
        step = state.rates * dt_s + turn * dt_s / 2 + update.rng.standard_normal(shape) * rest
        moved = retract(state.poses, step)
        low, high = domain.log_scale_bounds
        inside = np.clip(moved.position, 0, (domain.width, domain.height))
        joints = np.where(domain.wrapping, moved.joints, np.clip(moved.joints, *domain.joint_bounds))
        poses = domain.wrap(Poses(moved.quaternion, inside, np.clip(moved.log_scale, low, high), joints))
        rates, log_weights = state.rates + turn, state.log_weights
    else:
        nowhere = Evidence(0.25 * domain.width * domain.height, 0.5 * np.array([domain.width, domain.height]), 1.0)
        poses = place(update.rng, domain, nowhere, update.score_maps, count)
        rates, log_weights = np.zeros((count, domain.n_tangent)), np.full(count, -np.log(count))
    return Outcome(poses, log_weights, update.score(poses), rates, "no_target", 0.0, memory)


def conclude(update: Update, draws: Draws, evidence: Evidence) -> Outcome:
    """Status and memory after the frame."""
    memory: dict[str, NDArray[np.generic]] = {} if update.state is None else dict(update.state.memory)
    memory.update(draws.memory)
    fit = support(update, draws)
    lost = fit < SUPPORT_FLOOR
    before = float(update.recall("age", 0.0))
    memory["age"] = np.array(0.0 if lost else before + 1)
    memory["misfit"] = lately(update, "misfit", update.misfit(evidence, draws.poses, draws.log_likelihood))
    memory["support"] = lately(update, "support", fit)
    if not lost:
        memory["gain"] = lately(update, "gain", float(np.max(draws.log_likelihood)))
    status = "lost" if lost else "tracking" if before + 1 >= ESTABLISHED_FRAMES else "acquiring"
    log_weights, log_evidence = normalise(draws.log_weights)
    poses = update.domain.wrap(draws.poses)
    best = best_pose(update, draws)
    memory.update(heading(update, draws, best[0]))
    return Outcome(poses, log_weights, draws.log_likelihood, draws.rates, status, log_evidence, memory, best)

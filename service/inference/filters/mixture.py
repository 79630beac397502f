"""The default filter: modes that follow the light (docs/model.md, sections 5 and 6).

``step`` reads predict, propose, update, weigh, prune. What it knows of an image is ``given.LitFrame``.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from service.inference.filters.answer import drawn, estimate_of, unseen
from service.inference.filters.births import MOST_MODES, alike_by, is_another, same_mode
from service.inference.filters.displaced import carried_on, with_displaced
from service.inference.filters.effort import explains, is_doubted, part_due, searched_nats
from service.inference.filters.given import Given, Predicted, Updated
from service.inference.filters.grounds import followed_on, ground
from service.inference.filters.pointing import pointed
from service.inference.filters.returning import (
    as_it_was,
    gone_by_now,
    is_back,
    leading_again,
    moved_on,
    waiting,
    with_displaced_mode,
    within_reach,
)
from service.inference.filters.status import one_answer, status_of, told_existence
from service.inference.filters.weighing import weigh
from service.inference.held import believed
from service.inference.mesh_error import evidence_trust, stated
from service.inference.model import existence, prior
from service.inference.model.candidates import Candidates
from service.inference.model.rivals import Followed, rivals
from service.inference.model.search import Found, Track, most_parts, search
from service.inference.model.shaking import turning_joints
from service.inference.model.stages import FINEST, Part
from service.inference.motion import MotionNoise, motion_noise
from service.inference.numerics.gauss_newton import ENOUGH, ascend, within
from service.inference.numerics.hill import Hill, Refined
from service.inference.numerics.placing import placed
from service.inference.pose import concatenate
from service.inference.state import Estimate, FilterState, Mixture

_SIGHT = 1.6  # numerical: a patch's side over its light's span
_LEAST = 1e-3  # numerical: probability below which a mode is dropped


def step(rng: np.random.Generator, state: FilterState | None, given: Given) -> tuple[FilterState, Estimate]:
    """The posterior after a frame."""
    before = None if state is None else state.mixture
    noise = motion_noise(given.config.motion, given.domain)
    dt_s = 0.0 if state is None else max(given.time_s - state.time_s, 0.0)
    expected = None if before is None else predict(before, noise, dt_s)
    ahead = None if expected is None else with_displaced_mode(expected)
    judged = returned(before, ahead, noise, given, dt_s) or searched(rng, before, ahead, noise, given)
    if judged is None:
        return unseen(rng, given.domain, given.config.filter.particles, given.index, given.time_s)
    updated, after, hill = judged.updated, judged.after, judged.hill
    if expected is not None and before is not None and after.existence[existence.ABSENT] >= 0.5:
        after = waiting(after, expected, before)
    return concluded(rng, after, updated, hill, given)


@dataclass(frozen=True)
class Judged:
    """What is left after a frame."""

    updated: Updated
    after: Mixture
    hill: Hill


def returned(
    before: Mixture | None, ahead: Predicted | None, noise: MotionNoise, given: Given, dt_s: float
) -> Judged | None:
    """What is left where the body is again where it was expected, and fits, after a displacement or an absence.

    None: it is not, and a search may be due.
    """
    if before is None or ahead is None:
        return None
    was, again = before, ahead
    if ahead.returning is not None and ahead.displaced is not None:
        was, lead = as_it_was(before), int(np.argmax(ahead.log_weights))
        leader = ahead.poses[lead : lead + 1]
        stayed = bool(one_answer(leader, ahead.displaced.pose, given.twins, given.domain).any())
        again = leading_again(ahead, ahead.returning, was, gone_by_now(ahead.displaced, not stayed, dt_s))
    elif given.frame.sight is None or before.existence[existence.ABSENT] < 0.5 or not within_reach(ahead):
        return None
    judged = judge(was, pointed(again, was, given)[0], None, noise, given)
    if judged is None or not explains(judged.after):
        return None
    return judged if ahead.returning is None or is_back(judged.updated, ahead, given.domain) else None


def searched(
    rng: np.random.Generator, before: Mixture | None, ahead: Predicted | None, noise: MotionNoise, given: Given
) -> Judged | None:
    """What is left of the modes, where they are expected or where the frame shows their light, and of a search."""
    places = (ahead,) if before is None or ahead is None else pointed(ahead, before, given)
    found = propose(rng, before, places[0], given)
    judged = judge(before, places[0], found, noise, given)
    if judged is not None and not explains(judged.after) and len(places) > 1:
        other = judge(before, places[1], found, noise, given)
        if other is not None and (explains(other.after) or places[1] is ahead):  # as expected, where neither fits
            judged = other
    if judged is None or before is not None or found is None:
        return judged
    if not is_doubted(judged.after, given.domain.prior.mesh_error):
        return judged
    once_more = looked(rng, Track(found.candidates, doubted=True), given, shake=True)
    return judge(before, ahead, once_more, noise, given) or judged


def judge(
    before: Mixture | None, ahead: Predicted | None, found: Found | None, noise: MotionNoise, given: Given
) -> Judged | None:
    """Update, weigh and prune what was followed and what a search found; None: there is nothing of either."""
    hill, nuisance = ground(before, ahead, found, given)
    if hill is None or (ahead is None and not (found and found.basins)):
        return None
    gone = before is not None and bool(before.existence[existence.ABSENT] >= 0.5)
    far = bool(found and found.basins) or gone or (ahead is not None and ahead.returning is not None)
    refined = update(ahead, hill, given.domain.wrapping, far)
    updated = weigh(refined, ahead, found, hill, noise, nuisance, given, before)
    after = prune(updated, before, found, given, hill, None if ahead is None else ahead.returning)
    disturbed = updated.disturbed
    if before is not None and ahead is not None and is_another(updated, given):
        disturbed = unsearched(before, ahead, noise, given).disturbed
    after = with_displaced(after, before, ahead, disturbed, given)
    tracked = after.ever_tracked or status_of(after, given.twins, given.domain) == "tracking"
    return Judged(updated, replace(after, ever_tracked=tracked), hill)


def unsearched(before: Mixture, ahead: Predicted, noise: MotionNoise, given: Given) -> Updated:
    """The modes as if nothing had been found: under the air and the discrepancy that they explained frames with.

    Under those of a better answer a wrong one explains nothing, as if something had come between.
    """
    _, hill, nuisance = followed_on(before, ahead, given)
    refined = update(ahead, hill, given.domain.wrapping, far=False)
    return weigh(refined, ahead, None, hill, noise, nuisance, given, before)


def predict(before: Mixture, noise: MotionNoise, dt_s: float) -> Predicted:
    """Every mode carried on by its rates."""
    modes = moved_on(before, noise, dt_s, seen=bool(before.existence[existence.ABSENT] < 0.5))
    weights = prior.EVIDENCE_KEPT * before.log_weights
    weights = weights - np.logaddexp.reduce(weights)
    here = existence.expected(before.existence, dt_s)
    return Predicted(
        poses=modes.poses,
        rates=modes.rates,
        covariance=modes.covariance,
        suns=modes.suns,
        sun_sigmas=modes.sun_sigmas,
        paint=modes.paint,
        log_weights=weights,
        existence=here,
        displaced=carried_on(before.displaced, noise, dt_s),
    )


def propose(rng: np.random.Generator, before: Mixture | None, ahead: Predicted | None, given: Given) -> Found | None:
    """What a search of the whole space, or a part of one, finds; None where none is due."""
    mesh_error = given.domain.prior.mesh_error
    part = part_due(before, most_parts(given.body, given.told), mesh_error)
    if part is None:
        return None
    track = None
    if before is not None and ahead is not None:
        track = Track(Candidates(ahead.poses, ahead.suns, ahead.log_weights), is_doubted(before, mesh_error))
        if part.count > 1:
            return beside(rng, before, ahead, track, part, given)
    shake = before is not None and before.searches == 1 and bool(turning_joints(given.body.rough, given.told))
    return looked(None if before is None else rng, track, given, shake)


def looked(rng: np.random.Generator | None, track: Track | None, given: Given, shake: bool) -> Found | None:
    """A search of the frame, beside a track where there is one; None where nothing shows."""
    if given.frame.sight is None:
        return None
    look = given.body, given.frame.sight, given.bank(), given.told, given.frame.wide
    return search(*look, rng, alike_by(given), shake=shake, track=track)


def beside(
    rng: np.random.Generator, before: Mixture, ahead: Predicted, track: Track, part: Part, given: Given
) -> Found | None:
    """A part of a search, of which every frame has its own; None where nothing shows."""
    if given.frame.sight is None:
        return None
    sight, hill, nuisance = followed_on(before, ahead, given)
    followed = Followed(track.modes, sight, hill, nuisance)
    met = rivals(given.body, followed, given.bank(), given.told, part, rng, alike_by(given))
    return Found(met, hill, nuisance, part)


def update(ahead: Predicted | None, hill: Hill, wrapping: NDArray[np.bool_], far: bool) -> list[Refined]:
    """Each mode at its best under what was expected of it and what the frame says.

    None is weighed before it is there: what its next step would gain is worth less than a factor e of its weight.
    ``far``: all climb as far as what a search finds: beside that, and when they may be back after an absence.
    """
    if ahead is None:
        return []
    start = ahead.poses.position + ahead.aside
    poses = replace(ahead.poses, position=start, joints=within(hill.drawing, ahead.poses.joints))
    enough = np.full(len(poses), ENOUGH if far else 1 / prior.EVIDENCE_TRUST)
    enough[np.argmax(ahead.log_weights)] = ENOUGH
    believed = ahead.believed(wrapping)
    if ahead.returning is None:
        there = placed(hill, poses, ahead.suns, believed)
    else:  # the picture may have moved otherwise for what has come between
        each = slice(ahead.returning), slice(ahead.returning, None)
        apart = (placed(hill, poses[some], ahead.suns[some], ahead.believed(wrapping, some)) for some in each)
        there = concatenate(*apart)
    return ascend(hill, there, ahead.suns, steps=FINEST.steps, covariance="last", believed=believed, enough=enough)


def prune(
    updated: Updated,
    before: Mixture | None,
    found: Found | None,
    given: Given,
    hill: Hill,
    returning: int | None = None,
) -> Mixture:
    """The heaviest modes; those that met are one. A displaced answer's is kept elsewhere, unless it leads."""
    log_weights = updated.log_weights - np.logaddexp.reduce(updated.log_weights)
    if returning is not None and returning != int(np.argmax(log_weights)):
        log_weights[returning] = -np.inf
    kept: list[int] = []
    for k in np.argsort(-log_weights):
        same = [j for j in kept if same_mode(updated.refined[k], updated.refined[j], given.domain)]
        if same:
            log_weights[same[0]] = np.logaddexp(log_weights[same[0]], log_weights[k])
        elif len(kept) < MOST_MODES and log_weights[k] > np.log(_LEAST):
            kept.append(int(k))
    chosen = log_weights[kept] - np.logaddexp.reduce(log_weights[kept])
    another, part = is_another(updated, given), None if found is None else found.part
    searches, misses = (0, 0) if before is None else (before.searches, before.misses)
    parts = 0 if before is None or another else before.parts_searched
    whole = part is not None and part.is_last
    if another and before is not None and before.existence[existence.ABSENT] < 0.5:  # unseen it may turn anywhere
        misses += round(searches * existence.share_met(before.searched_nats))  # should have met the truth
    return Mixture(
        poses=concatenate(*[updated.refined[k].pose for k in kept]),
        rates=updated.rates[kept],
        covariance=updated.covariance[kept],
        suns=np.stack([updated.refined[k].sun for k in kept]),
        sun_sigmas=np.array([updated.refined[k].sun_sigma for k in kept]),
        paint=updated.paint[kept],
        log_weights=chosen,
        existence=updated.existence,
        point_spread=np.array([updated.nuisance.core, updated.nuisance.wings]),
        discrepancy=updated.nuisance.discrepancy,
        log_discrepancy=updated.log_discrepancy,
        photon=updated.nuisance.photon,
        hides=updated.nuisance.hides,
        sharpened=updated.nuisance.sharpened,
        mask=updated.nuisance.mask,
        log_chi2=updated.log_chi2,
        log_light=updated.log_light,
        span_px=hill.view.side * hill.view.binning / _SIGHT,
        ever_tracked=before is not None and before.ever_tracked,
        searches=(0 if another else searches) + whole,
        misses=misses,
        since_search=0 if whole or before is None else before.since_search + 1,
        searched_nats=searched_nats(before, whole, updated),
        parts_searched=0 if whole else parts + (part is not None),
    )


def concluded(
    rng: np.random.Generator, after: Mixture, updated: Updated, hill: Hill, given: Given
) -> tuple[FilterState, Estimate]:
    """The state and the answer."""
    told = stated(believed(after, given.held), given.domain)
    poses, rates = drawn(rng, told, given.config.filter.particles, given.domain)
    status = status_of(told, given.twins, given.domain)
    log_weights = updated.log_weights
    if given.held is not None:
        every = np.concatenate([one.pose.quaternion for one in updated.refined])
        log_weights = log_weights + given.held.log_ratio(every)
    best = updated.refined[int(np.argmax(log_weights))]
    fit, existed = existence.goodness(hill, best.fit), told_existence(after, given.domain.prior.mesh_error)
    evidence = best.fit.log_evidence, evidence_trust(given.domain) * updated.nats
    estimate = estimate_of(told, poses, status, given.domain, existed, evidence, fit)
    count = len(poses)
    even = np.full(count, -np.log(count))
    return FilterState(poses, even, rates, given.index, given.time_s, status, {}, after), estimate

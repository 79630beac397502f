"""Evidence of modes that were followed, of newborn ones, and of the three hypotheses (docs/model.md, 5 and 6)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from service.inference.domain import Domain
from service.inference.estimate import tangent
from service.inference.filters.births import followed_to, newborn, repainted
from service.inference.filters.given import Given, Predicted, Updated
from service.inference.filters.status import followed_share
from service.inference.mesh_error import evidence_trust
from service.inference.model import existence, paint, prior
from service.inference.model.dynamics import corrected, new_born
from service.inference.model.nuisance import Nuisance, lets_through, log_prior, neighbour, scene_under
from service.inference.model.search import Found
from service.inference.motion import MotionNoise
from service.inference.numerics.hill import Hill, Refined
from service.inference.state import Array, Mixture, Poses

# numerical: nats that light gains at the most, fitted anew as another body's: 121 in 262 frames
_REFITTED = 200.0


@dataclass(frozen=True)
class Weighed:
    """One mode after a frame."""

    one: Refined
    rates: Array
    covariance: Array  # (2d, 2d)
    log_weight: float
    occam: float  # log of the share of its prior that the frame leaves
    alone: float  # log evidence of this frame, as if nothing had been expected of its pose
    paint: Array  # (2, P) that was expected


@dataclass(frozen=True)
class Looks:
    """Log evidences of one mode beside its own, and what the frame says of its discrepancy."""

    afresh: float  # were its paint unknown
    unlike: float  # as of another body
    elsewhere: float  # under another air
    log_discrepancy: Array  # (2,)


@dataclass(frozen=True)
class Usual:
    """What earlier frames say of a body's light, and of what it leaves over."""

    log_light: float | None
    log_chi2: Array  # (2,) mean and variance
    answered: float  # probability that it was this body's


def weigh(
    refined: list[Refined],
    ahead: Predicted | None,
    found: Found | None,
    hill: Hill,
    noise: MotionNoise,
    nuisance: Nuisance,
    given: Given,
    before: Mixture | None,
) -> Updated:
    """All modes with what the frame says of them, and of whether any of them is true."""
    trust, usual = evidence_trust(given.domain), usual_of(before, given.domain.prior.mesh_error)
    level, afresh = None, -np.inf  # weight of no evidence in this frame; evidence of the leader were its paint unknown
    other, looks = neighbour(nuisance, given.index, hill.scene.hidden), None
    turned, new = newborn(refined, ahead, found, given)
    modes = [] if ahead is None else all_followed(refined, turned, ahead, hill, given)
    n_followed, lead = len(modes), max(modes, key=lambda mode: mode.log_weight, default=None)
    if lead is not None:
        looks = looks_at(lead, hill, other)
        others = [one.fit.log_evidence for one, k in new if k is not None and modes[k] is lead]
        afresh = max([looks.afresh, *others])
        alone = lead.alone + afresh - lead.one.fit.log_evidence
        level = lead.log_weight - trust * alone
    for one, k in new:
        if ahead is None or k is None:
            unlearnt = paint.unlearnt(len(one.fit.coefficients))
            modes.append(born(one, level, len(new), unlearnt, noise, given.domain))
        else:
            same = modes[k].log_weight - trust * modes[k].alone
            one = repainted(one, ahead.paint[k], hill, given.domain.wrapping)
            modes.append(born(one, same, len(new), ahead.paint[k], noise, given.domain))
    best = max(modes, key=lambda mode: mode.log_weight)
    absent = existence.log_absent(hill)
    if looks is None or best is not lead:
        looks = looks_at(best, hill, other)
    seen, afresh = (best, looks), max(afresh, looks.afresh)
    explained = best.one.fit.log_evidence + best.occam + log_prior(nuisance, hill)
    light = existence.log_light(hill, best.one.fit)
    probabilities = hypotheses(best, (absent, afresh, looks.unlike), light, ahead, usual)
    fits = float(probabilities[existence.FITS])
    return Updated(
        refined=[mode.one for mode in modes],
        rates=np.array([mode.rates for mode in modes]),
        covariance=np.array([mode.covariance for mode in modes]),
        paint=np.stack(
            [paint.learnt(mode.one.fit, hill.terms, mode.paint, mode.one.paint_variance, fits) for mode in modes]
        ),
        log_weights=np.array([mode.log_weight for mode in modes]),
        existence=probabilities,
        nuisance=better_air(best, looks, (nuisance, other), hill),
        log_chi2=existence.usual_chi2(usual.log_chi2, best.one.fit.chi2, fits),
        log_light=existence.usual_light(usual.log_light, light, fits),
        log_discrepancy=existence.log_discrepancy_so_far(
            None if before is None or best is not lead else before.log_discrepancy, looks.log_discrepancy, fits
        ),
        nats=explained - absent,
        hidden=existence.hidden_share(hill, best.one.fit),
        n_followed=n_followed,
        disturbed=0.0 if ahead is None or before is None else come_between(modes, seen, hill, other, ahead, before),
    )


def all_followed(
    refined: list[Refined], turned: list[tuple[Poses, Refined, int]], ahead: Predicted, hill: Hill, given: Given
) -> list[Weighed]:
    """The modes that were expected, and after them where a search met them, turned further than they climb."""
    here = [(k, one, ahead.paint[k]) for k, one in enumerate(refined)]
    there = followed_to(turned, refined, ahead, hill, given)
    return [followed(k, one, ahead, learnt, given.domain) for k, one, learnt in [*here, *there]]


def followed(k: int, one: Refined, ahead: Predicted, expected: Array, domain: Domain) -> Weighed:
    """A mode that was expected: a power of its evidence, and of the share of its prior that the frame leaves.

    ``expected`` (2, P): paint that its evidence is under.
    """
    d = ahead.rates.shape[1]
    wide = ahead.covariance[k][:d, :d]
    shift = tangent(ahead.poses[k : k + 1], one.pose, domain.wrapping)[0]
    rates, covariance = corrected(ahead.rates[k], ahead.covariance[k], shift, one.covariance)
    narrowed = 0.5 * float(np.linalg.slogdet(one.covariance)[1] - np.linalg.slogdet(wide)[1])
    narrowed += 2 * float(np.log(one.sun_sigma / ahead.sun_sigmas[k]))
    away = -0.5 * float(shift @ np.linalg.solve(wide, shift))
    weight = float(ahead.log_weights[k]) + evidence_trust(domain) * (one.log_posterior + narrowed)
    return Weighed(one, rates, covariance, weight, narrowed + away, one.log_posterior - away, expected)


def born(
    one: Refined, level: float | None, siblings: int, expected: Array, noise: MotionNoise, domain: Domain
) -> Weighed:
    """A basin of a search: it might have been anywhere.

    ``level``: the weight of no evidence in this frame, of what was followed; None: nothing was. Beside a track only the
    height of its evidence counts: frames before this one would have narrowed it as they have narrowed the track.
    ``expected`` (2, P): paint that its evidence is under.
    """
    d = len(one.covariance)
    narrow = 0.5 * float(np.linalg.slogdet(one.covariance)[1])
    share = narrow + 0.5 * d * float(np.log(2 * np.pi)) - domain.log_volume
    trust = evidence_trust(domain)
    weight = trust * one.log_posterior
    if level is None:
        weight += trust * (narrow + 2 * float(np.log(one.sun_sigma)))
    else:
        weight += level + float(np.log(prior.BIRTH / siblings))  # one of them at the most is the truth
    return Weighed(one, np.zeros(d), new_born(one.covariance, noise), weight, share, one.log_posterior, expected)


def better_air(best: Weighed, looks: Looks, airs: tuple[Nuisance, Nuisance], hill: Hill) -> Nuisance:
    """Of the one that a frame was seen under and of the other that it was looked at under."""
    nuisance, other = airs
    better = looks.elsewhere + log_prior(other, hill) > best.one.fit.log_evidence + log_prior(nuisance, hill)
    return other if better and lets_through(hill, other) else nuisance


def looks_at(mode: Weighed, hill: Hill, other: Nuisance) -> Looks:
    """One mode in one launch, its picture as it is."""
    fit, (less, more) = mode.one.fit, existence.scenes_about(hill)
    ways = [(hill.scene, None), (scene_under(hill, other), mode.paint), (less, mode.paint), (more, mode.paint)]
    unlike = existence.log_unlike_of(hill, fit)
    if unlike > fit.log_evidence - _REFITTED:
        ways.append((existence.scene_unlike(hill), None))
    logs = [float(one) for one in hill.log_evidences_under(fit.planes, ways, fit.values[None])[:, 0]]
    afresh, elsewhere, below, above, *refitted = logs
    gains = below - fit.log_evidence, above - fit.log_evidence
    told = existence.log_discrepancy(hill.scene.discrepancy, gains)
    return Looks(afresh, refitted[0] if refitted else unlike, elsewhere, told)


def hypotheses(
    best: Weighed,
    evidences: tuple[float, float, float],
    light: float,
    ahead: Predicted | None,
    usual: Usual,
) -> Array:
    """(3,) probabilities of ``model.existence``, as if the truth were among the modes.

    ``evidences``: logs of the sky's alone, of the best mode were its paint unknown, and as of another body. Light that
    asks for other paint than the body has, or goes out, is explained by something that is between, or by another body.
    ``light``: log of the body's whole light.
    """
    start = existence.expected(None, 0.0)
    if ahead is not None:
        start = usual.answered * ahead.existence + (1 - usual.answered) * start
    fit, starts = best.one.fit, np.log(np.maximum(start, 1e-9))
    absent, afresh, unlike = evidences
    seen = fit.log_evidence + best.occam
    changed = existence.log_of_change(usual.log_light, light, usual.answered)
    if seen <= absent and 0 < usual.answered < 1:  # nothing shows: what was something else's light is not seen either
        changed = existence.log_of_change(usual.log_light, light) + float(np.log(usual.answered))
        elsewhere = float(starts[existence.FITS] - starts[existence.ABSENT] + np.log1p(-usual.answered)) + seen
        absent = float(np.logaddexp(absent, elsewhere))
    fits, between = seen + changed, max(fit.log_evidence, afresh, unlike) + best.occam
    logs = starts + np.array([absent, fits, max(fits, between)])
    logs[existence.NO_FIT] += existence.log_of_disturbance(fit.chi2, usual.log_chi2)
    return np.asarray(np.exp(logs - np.logaddexp.reduce(logs)))


def come_between(
    modes: list[Weighed],
    seen: tuple[Weighed, Looks],
    hill: Hill,
    other: Nuisance,
    ahead: Predicted,
    before: Mixture,
) -> float:
    """Probability that something has come between, were the answer right that was the last.

    ``seen``: a mode that was looked at already, and what was seen (``looks_at``).
    """
    answer = modes[int(np.argmax(ahead.log_weights))]
    looks = seen[1] if answer is seen[0] else looks_at(answer, hill, other)
    light = existence.log_light(hill, answer.one.fit)
    usual = Usual(before.log_light, before.log_chi2, 1.0)
    _, fits, no_fit = hypotheses(answer, (-np.inf, looks.afresh, looks.unlike), light, ahead, usual)
    return float(no_fit / (fits + no_fit))


def usual_of(before: Mixture | None, mesh_error: float) -> Usual:
    """What earlier frames say, as far as what they were explained with was this body: a star, a bird, a pose that was
    wrong tell nothing of it.
    """
    if before is None:
        return Usual(None, existence.usual_chi2(), 0.0)
    answered = min(followed_share(before, mesh_error), 1 - prior.ANSWER_WRONG)
    return Usual(before.log_light, existence.level_if(before.log_chi2, answered), answered)

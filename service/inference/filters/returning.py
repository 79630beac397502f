"""Modes through frames that do not show them: none is seen at all, or something has come between (docs/model.md, 6)."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from service.inference.domain import Domain
from service.inference.filters.births import same_mode
from service.inference.filters.given import Predicted, Updated
from service.inference.model import paint, prior
from service.inference.model.dynamics import predicted, predicted_suns, turn
from service.inference.motion import MotionNoise
from service.inference.numerics.hill import Trust
from service.inference.pose import concatenate, retract
from service.inference.state import Displaced, Mixture

_SHORTEST_S = 1e-9  # numerical: between two frames


def moved_on(modes: Mixture, noise: MotionNoise, dt_s: float, *, seen: bool) -> Mixture:
    """Every mode carried on by its rates, and what is known of it as far as it lasts.

    ``seen``: the last frame told of them, and the next one repeats a part of that.
    """
    return replace(
        modes,
        poses=retract(modes.poses, modes.rates * dt_s),
        covariance=np.stack([predicted(one, noise, dt_s, seen=seen) for one in modes.covariance]),
        sun_sigmas=predicted_suns(modes.sun_sigmas, dt_s, seen=seen),
        paint=paint.expected(modes.paint, turn(modes.rates, modes.covariance, dt_s)),
    )


def waiting(after: Mixture, ahead: Predicted, before: Mixture) -> Mixture:
    """The modes as they were expected, while there is nothing to see."""
    return replace(
        before,
        poses=ahead.poses,
        covariance=ahead.covariance,
        sun_sigmas=ahead.sun_sigmas,
        paint=ahead.paint,
        log_weights=ahead.log_weights,
        existence=after.existence,
        searches=after.searches,
        since_search=after.since_search,
        parts_searched=after.parts_searched,
        displaced=ahead.displaced,
    )


def with_displaced_mode(ahead: Predicted) -> Predicted:
    """The modes, and behind them the displaced answer's, where that is as likely as a truth that no mode holds.

    What has come between goes away, and the body is back where it was expected: no search is needed to find it.
    """
    known = ahead.displaced
    if known is None or known.was is None or known.probability < prior.BIRTH:
        return ahead
    was = known.was
    weights = np.append(ahead.log_weights, ahead.log_weights.max() + np.log(prior.BIRTH))
    return replace(
        ahead,
        poses=concatenate(ahead.poses, known.pose),
        rates=np.concatenate([ahead.rates, known.rates]),
        covariance=np.concatenate([ahead.covariance, was.covariance]),
        suns=np.concatenate([ahead.suns, was.suns]),
        sun_sigmas=np.concatenate([ahead.sun_sigmas, was.sun_sigmas]),
        paint=np.concatenate([ahead.paint, was.paint]),
        log_weights=weights - np.logaddexp.reduce(weights),
        returning=len(ahead.log_weights),
    )


def alone(ahead: Predicted, k: int, before: Mixture) -> Mixture:
    """One mode as it is expected, and what frames before have told beside it."""
    one = slice(k, k + 1)
    return replace(
        before,
        poses=ahead.poses[one],
        rates=ahead.rates[one],
        covariance=ahead.covariance[one],
        suns=ahead.suns[one],
        sun_sigmas=ahead.sun_sigmas[one],
        paint=ahead.paint[one],
        log_weights=np.zeros(1),
        displaced=None,
    )


def within_reach(ahead: Predicted) -> bool:
    """Whether a climb from where the leader is expected surely ends where it is: it turned no further than one step."""
    turn = ahead.covariance[int(np.argmax(ahead.log_weights))][:3, :3]
    return float(np.linalg.eigvalsh(turn)[-1]) <= Trust().turn ** 2


def leading_again(ahead: Predicted, returning: int, was: Mixture, gone: float) -> Predicted:
    """The modes with the displaced answer's before the others, as it was: a frame is looked at where it should be.

    ``gone``: probability that what has come between is.
    """
    weights = ahead.log_weights.copy()
    weights[returning] = np.delete(weights, returning).max() - np.log(prior.BIRTH)
    absent, fits, no_fit = was.existence
    here = np.array([absent, fits * gone, no_fit + fits * (1 - gone)])
    return replace(ahead, log_weights=weights - np.logaddexp.reduce(weights), existence=here)


def gone_by_now(known: Displaced, led_elsewhere: bool, dt_s: float) -> float:
    """Probability that what has come between is gone.

    How long it lasts has no scale: it outlasts T + dt, if it has lasted T, with probability T / (T + dt). A bird passes
    in a moment, and a cloud of a minute stays for more. ``led_elsewhere``: the leader was another, and an answer that
    fits where it was expected is no chance.
    """
    return 1.0 if led_elsewhere else dt_s / max(known.since_s + dt_s, _SHORTEST_S)


def is_back(updated: Updated, ahead: Predicted, domain: Domain) -> bool:
    """Whether the displaced answer's mode leads again, or has met the one that leads."""
    lead, returning = int(np.argmax(updated.log_weights)), ahead.returning
    return returning is not None and same_mode(updated.refined[lead], updated.refined[returning], domain)


def as_it_was(before: Mixture) -> Mixture:
    """With the air, the light, the discrepancy and the searches of the displaced answer, not of what displaced it."""
    known = before.displaced
    if known is None or known.was is None:
        return before
    return replace(
        known.was,
        ever_tracked=before.ever_tracked,
        since_search=before.since_search,
        answered=before.answered,
        displaced=known,
    )

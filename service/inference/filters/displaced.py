"""An answer that another displaced (docs/model.md, section 6): which of both is the body, and which a cloud's work?

Under a cloud, or behind another body, light that the modes do not explain often has another pose that does. A body does
not turn there between two frames: so either what was told before was wrong, or something has come between.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from service.inference.filters.given import Given, Predicted
from service.inference.filters.returning import alone, moved_on
from service.inference.filters.status import equivalents, leading_share, one_answer, told_existence
from service.inference.model import existence, prior
from service.inference.motion import MotionNoise
from service.inference.numerics.student import log_density
from service.inference.pose import local, retract
from service.inference.state import Array, Displaced, Mixture, Poses

_NOTHING = 1e-300  # numerical: divides by nothing
_LEAST = 1e-3  # numerical: probability below which it is forgotten
_LOG_TURNS = float(np.log(8 * np.pi**2))  # exact: of the volume of all rotations, rad^3


def carried_on(before: Displaced | None, noise: MotionNoise, dt_s: float) -> Displaced | None:
    """Ahead of a frame: where it would be; what has come between goes away again, and then it would be seen."""
    if before is None:
        return None
    odds = before.probability / (1 - before.probability) * np.exp(-prior.CHANGES_PER_S * dt_s)
    pose = retract(before.pose, before.rates * dt_s)
    was = None if before.was is None else moved_on(before.was, noise, dt_s, seen=False)
    return Displaced(float(odds / (1 + odds)), pose, before.rates, was, before.since_s + dt_s)


def with_displaced(
    after: Mixture, before: Mixture | None, ahead: Predicted | None, disturbed: float, given: Given
) -> Mixture:
    """The modes with what is known of an answer that their leader displaced, and what is told of the leader itself.

    ``disturbed``: probability that something has come between, were the last answer right.
    """
    if before is None or ahead is None:
        return with_answer(after, 0.0, given)
    lead, last = int(np.argmax(after.log_weights)), int(np.argmax(ahead.log_weights))
    leader, answer, known = after.poses[lead : lead + 1], ahead.poses[last : last + 1], ahead.displaced
    d = ahead.rates.shape[1]
    wide = ahead.covariance[last][:d, :d]
    is_back = known is not None and bool(one_answer(leader, known.pose, given.twins, given.domain).any())
    if known is not None and is_back:
        kept = None if after.existence[existence.FITS] >= 0.5 else known  # what has come between is there still
        return with_answer(replace(after, displaced=kept), known.probability, given)
    if known is not None and fits_again(before, after):
        right = was_right(known.probability, 1.0, moved(known.pose, wide, leader, after, given))
        known = replace(known, probability=right)
    here = Displaced(0.0, answer, ahead.rates[last : last + 1], alone(ahead, last, before))
    if one_answer(leader, answer, given.twins, given.domain).any():
        if known is None and begins_to_fail(before, after):  # what is between may lead it away in the next
            known = replace(here, probability=before.answered * float(after.existence[existence.NO_FIT]))
        return with_answer(replace(after, displaced=known), before.answered, given)
    if before.existence[existence.ABSENT] < 0.5:  # unseen it may turn anywhere
        right = was_right(before.answered, disturbed, moved(answer, wide, leader, after, given))
        if known is not None and one_answer(answer, known.pose, given.twins, given.domain).any():
            here = known  # as it was before frames that it does not fit
        fitted = here is known or bool(before.existence[existence.FITS] >= 0.5)  # else it is where a frame dragged one
        if known is None or (fitted and right > known.probability):
            known = replace(here, probability=right)
    return with_answer(replace(after, displaced=known), 0.0, given)


def fits_again(before: Mixture, after: Mixture) -> bool:
    """Whether a frame is the first that the modes explain since one that they did not."""
    return bool(before.existence[existence.FITS] < 0.5 <= after.existence[existence.FITS])


def begins_to_fail(before: Mixture, after: Mixture) -> bool:
    """Whether a frame is the first in which something has come before what the modes explained."""
    return bool(before.existence[existence.FITS] >= 0.5 and after.existence[existence.NO_FIT] >= 0.5)


def moved(pose: Poses, wide: Array, there: Poses, after: Mixture, given: Given) -> float:
    """Odds that it has turned to where it leads now, against something between: what nothing fits, it has not."""
    _, fits, no_fit = after.existence
    return turns_there(pose, wide, there, given) * float(fits / max(no_fit, _NOTHING))


def with_answer(after: Mixture, before: float, given: Given) -> Mixture:
    """With what its leader is told with where it fits; else with what it was told with ``before``."""
    if after.displaced is not None and after.displaced.probability < _LEAST:
        after = replace(after, displaced=None)
    fits = float(told_existence(after, given.domain.prior.mesh_error)[existence.FITS])
    now = before if fits < 0.5 else fits * leading_share(after, given.twins, given.domain)
    return replace(after, answered=now)


def was_right(answered: float, disturbed: float, moved: float) -> float:
    """Probability that an answer is right which another displaced, that explains the frame better.

    Then something has come between (``disturbed``, the probability of that were the answer right). Else it was wrong
    when it was told with ``answered``, or the body has turned since: ``moved``, density of that over that of any turn,
    times the odds against something between, ahead of the frame.
    """
    answered = min(answered, 1 - prior.ANSWER_WRONG)
    right = answered * disturbed
    return float(right / (right + (1 - answered) + answered * moved))


def turns_there(pose: Poses, wide: Array, there: Poses, given: Given) -> float:
    """Density with which a pose that is expected with scale ``wide`` (d, d) has turned to another, over that of any."""
    turns = local(pose, equivalents(there, given.twins, given.domain))[:, :3]
    density = log_density(turns, wide[:3, :3], prior.POSE_DEGREES_OF_FREEDOM)
    return float(np.exp(density + _LOG_TURNS).sum())

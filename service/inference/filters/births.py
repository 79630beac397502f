"""What a search finds beside the modes: one of them, turned far, or an answer that none had (docs/model.md, 6)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from service.inference.domain import Domain
from service.inference.estimate import short_way, tangent
from service.inference.filters.given import Given, Predicted, Updated
from service.inference.filters.status import equivalents, one_answer
from service.inference.model import paint, prior
from service.inference.model.candidates import turned_alike
from service.inference.model.search import Found
from service.inference.model.stages import FINEST
from service.inference.numerics.gauss_newton import ascend
from service.inference.numerics.hill import Hill, Refined
from service.inference.numerics.priors import Believed
from service.inference.pose import angle_between, concatenate
from service.inference.revolution import angle_apart
from service.inference.state import Array, Poses
from service.inference.symmetry import twin

MOST_MODES = 6  # numerical: that are kept
_LEAST = 1e-12  # numerical: variance
_SAME_DEG = 2.5  # numerical: modes nearer than this have met
_SAME_JOINT_SIGMAS = 3.0  # numerical: their joints agree within so many
# exact: rad, and of a joint's range: standard deviations at which a Gaussian is as high as a uniform law
_ANY_TURN, _ANY_JOINT = (8 * np.pi**2) ** (1 / 3) / np.sqrt(2 * np.pi), 1 / np.sqrt(2 * np.pi)


def newborn(
    refined: list[Refined], ahead: Predicted | None, found: Found | None, given: Given
) -> tuple[list[tuple[Poses, Refined, int]], list[tuple[Refined, int | None]]]:
    """Basins of a search that no mode holds already: where a mode has turned to, and those that are born.

    The first with the pose as that mode turns and its number. Of the others each with the mode that it is turned as;
    None: as no other. Paint is the body's: another place for a mode has what the mode has learnt. A pose unlike all
    modes' says that they were wrong, and that nothing is learnt yet.
    """
    turned: list[tuple[Poses, Refined, int]] = []
    born: list[tuple[Refined, int | None]] = []
    for one in [] if found is None else found.basins[:MOST_MODES]:
        if any(same_mode(one, other, given.domain) for other in refined):
            continue
        there = None if ahead is None else turned_from(one.pose, ahead, given)
        if there is not None:
            turned.append((there[0], one, there[1]))
            continue
        alike = None if ahead is None else turned_alike(one.pose, ahead.poses, given.body.fine.articulation)
        born.append((one, None if alike is None or not alike.any() else int(np.argmax(alike))))
    return turned, born


def turned_from(pose: Poses, ahead: Predicted, given: Given) -> tuple[Poses, int] | None:
    """The mode that has turned to a pose (a batch of one), and the pose as it is turned then, of all that cannot be
    told from it; None: sooner the truth was among no modes.

    A mode whose rate is not known yet, or that was not seen for long, may be turned far from where it is expected.
    """
    poses = equivalents(pose, given.twins, given.domain)
    ratios = np.stack([_turned(ahead, k, poses, given.domain) for k in range(len(ahead.poses))])
    ratios += ahead.log_weights[:, None]
    k, e = np.unravel_index(int(np.argmax(ratios)), ratios.shape)
    if ratios[k, e] + np.log1p(-prior.BIRTH) <= np.log(prior.BIRTH):
        return None
    return poses[int(e) : int(e) + 1], int(k)


def _turned(ahead: Predicted, k: int, poses: Poses, domain: Domain) -> Array:
    """(N,) log densities with which a mode has turned to N poses, body and joints, over those of any; never wider."""
    free = np.r_[0:3, 6 : ahead.rates.shape[1]]
    any_turn = np.r_[np.full(3, _ANY_TURN), _ANY_JOINT * domain.articulation.spans]
    variance, axes = np.linalg.eigh(ahead.covariance[k][np.ix_(free, free)] / np.outer(any_turn, any_turn))
    variance = np.clip(variance, _LEAST, 1.0)
    off = tangent(ahead.poses[k : k + 1], poses, domain.wrapping)[:, free] / any_turn @ axes
    return np.asarray(-0.5 * np.sum(off**2 / variance, axis=1) - 0.5 * np.sum(np.log(variance)))


def followed_to(
    turned: list[tuple[Poses, Refined, int]], refined: list[Refined], ahead: Predicted, hill: Hill, given: Given
) -> list[tuple[int, Refined, Array]]:
    """The same, climbed to their best under what was expected of their modes; without those that are back at one.

    Each with its mode's number, and the paint (2, P) that is expected of it, turned so far.
    """
    if not turned:
        return []
    k = np.array([number for _, _, number in turned])
    suns, poses = np.stack([one.sun for _, one, _ in turned]), concatenate(*[pose for pose, _, _ in turned])
    further = angle_between(ahead.poses[k].quaternion, poses.quaternion)
    learnt = paint.expected(ahead.paint[k], further)
    believed = replace(ahead.believed(given.domain.wrapping, k), paint=learnt)
    there = ascend(hill, poses, suns, steps=FINEST.steps, covariance="last", believed=believed)
    return [
        (int(number), one, paint_there)
        for number, one, paint_there in zip(k, there, learnt, strict=True)
        if not any(same_mode(one, other, given.domain) for other in refined)
    ]


def repainted(one: Refined, learnt: Array, hill: Hill, wrapping: NDArray[np.bool_]) -> Refined:
    """A basin, climbed to its best under paint (2, P) that is known."""
    free = np.zeros((1, *one.covariance.shape))
    believed = Believed(one.pose, free, wrapping, learnt[None], one.sun[None], np.zeros(1))
    return ascend(hill, one.pose, one.sun[None], steps=FINEST.steps, covariance="last", believed=believed)[0]


def same_mode(one: Refined, other: Refined, domain: Domain) -> bool:
    """Whether two modes are one."""
    axes = domain.articulation.round_axes
    if float(angle_apart(one.pose.quaternion, other.pose.quaternion, axes)[0]) > np.deg2rad(_SAME_DEG):
        return False
    apart = np.abs(short_way(other.pose.joints - one.pose.joints, domain.wrapping)[0])
    wide: NDArray[np.float64] = np.sqrt(np.diag(other.covariance)[6:])
    return bool(np.all(apart <= _SAME_JOINT_SIGMAS * wide + _SAME_DEG))


def is_another(updated: Updated, given: Given) -> bool:
    """Whether the leader is an answer that no mode had: one that was born beside a mode that it betters is not."""
    lead, n = int(np.argmax(updated.log_weights)), updated.n_followed
    if lead < n:
        return False
    poses = [one.pose for one in updated.refined]
    return n == 0 or not one_answer(poses[lead], concatenate(*poses[:n]), given.twins, given.domain).any()


def alike_by(given: Given) -> Callable[[Poses], Poses] | None:
    """The symmetry-equivalents of poses; None: there are none."""

    def alike(poses: Poses) -> Poses:
        return given.domain.wrap(concatenate(*[twin(poses, symmetry) for symmetry in given.twins]))

    return alike if given.twins else None

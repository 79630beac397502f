"""What lies around the best pose of a search: bottoms of its valley, sides of its panels (docs/model.md, 4)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from service.inference.model.candidates import Candidates, distinct, joined, scored, searched_joints
from service.inference.model.stages import FINEST
from service.inference.numerics.gauss_newton import ascend, stepped
from service.inference.numerics.hill import Hill, Refined
from service.inference.pose import concatenate
from service.inference.revolution import Axis
from service.inference.state import Array

SAME_DEG = 2.0  # numerical: after refinement
# numerical: poses around the best, how far about they lie, how far along
_SHAKEN, _SHAKEN_RAD, _ALONG_RAD = 24, 0.12, 0.2
_SHAKEN_PLACE, _SHAKEN_SCALE = 0.1, 0.2  # numerical: of that angle, place in radii of the body, log scale
# numerical: of each kind, how many are tried; how many climb to the end
_ABOUT, _ALONG, _TURNED, _SHAKEN_KEPT = 2, 5, 2, 2
_BETTER = 1.0  # numerical: nats by which a basin may be bettered without another look
_TRIAL_STEPS = 2  # numerical: of the finest stage, of what is shaken
# numerical: by which joints are tried
_TURNS_DEG = (-90.0, -60.0, -30.0, -15.0, 15.0, 30.0, 60.0, 90.0, 180.0)


def shaken(clear: Hill, hill: Hill, one: Refined) -> list[Refined]:
    """The best of what lies around a pose: what was flat while it was coarse is rough when it is fine.

    ``clear``: where neighbours are chosen, which costs half; they climb on ``hill`` alone, where the pose was refined:
    on a clear hill they end in other valleys.

    Some lie some degrees about it in every direction. More lie along its own covariance, widened: turn, place and size
    make up for each other, and such a valley may have several bottoms. Of others one joint is turned: its evidence has
    many tops, from each side of a panel and wherever its edge lies on another's, and only fine pictures tell them.
    """
    d = 6 + one.pose.joints.shape[1]
    drawn = np.random.default_rng(_SHAKEN).standard_normal((2, _SHAKEN, d))
    about, along = drawn[0], drawn[1]
    about[:, :3] *= _SHAKEN_RAD
    about[:, 3:5] *= _SHAKEN_PLACE * _SHAKEN_RAD * hill.drawing.radius * np.exp(one.pose.log_scale)
    about[:, 5] *= _SHAKEN_SCALE * _SHAKEN_RAD
    about[:, 6:] *= np.rad2deg(_SHAKEN_RAD)
    values, vectors = np.linalg.eigh(one.covariance)
    turn = np.sqrt(np.linalg.eigvalsh(one.covariance[:3, :3])[-1])
    along = along * np.sqrt(np.maximum(values, 0.0)) @ vectors.T * (_ALONG_RAD / turn)
    kinds = (about, _ABOUT), (along, _ALONG), (turns_of_joints(hill, d), _TURNED)
    near = joined([around(clear, one, steps)[:most] for steps, most in kinds if len(steps)])
    light = np.tile(one.fit.values, (len(near), 1))
    out = ascend(hill, near.poses, near.suns, steps=_TRIAL_STEPS, covariance="none", near=light)
    out = sorted(out, key=lambda tried: -tried.log_posterior)[:_SHAKEN_KEPT]
    out = [tried for tried in out if tried.log_posterior > one.log_posterior + _BETTER or apart(hill, tried, one)]
    if not out:
        return []
    poses, suns = concatenate(*[tried.pose for tried in out]), np.stack([tried.sun for tried in out])
    light = np.stack([tried.fit.values for tried in out])
    return ascend(hill, poses, suns, steps=FINEST.steps, covariance="last", near=light)


def turns_of_joints(hill: Hill, d: int) -> Array:
    """(N, d) steps of one joint each, of those that turn and of which nothing is known."""
    joints, out = hill.drawing.articulation.joints, []
    for k in searched_joints(hill.drawing, hill.told):
        if joints[k].kind == "revolute":
            out.append(np.zeros((len(_TURNS_DEG), d)))
            out[-1][:, 6 + k] = _TURNS_DEG
    return np.concatenate(out) if out else np.zeros((0, d))


def best_of_each(some: Sequence[Refined], axes: Sequence[Axis]) -> list[Refined]:
    """The best of each basin, best first. ``axes``: of a body of revolution."""
    ordered = sorted(some, key=lambda one: -one.log_posterior)
    kept = distinct(concatenate(*[one.pose for one in ordered]), np.deg2rad(SAME_DEG), axes=axes)
    return [ordered[k] for k in kept]


def apart(hill: Hill, one: Refined, other: Refined) -> bool:
    """Whether two poses are two basins."""
    return len(best_of_each([one, other], hill.drawing.articulation.round_axes)) > 1


def around(hill: Hill, one: Refined, steps: Array) -> Candidates:
    """A pose's neighbours, best first."""
    start = one.pose[np.zeros(len(steps), dtype=np.intp)]
    moved = stepped(hill.drawing, start, steps)
    neighbours = Candidates(moved, np.tile(one.sun, (len(steps), 1)), np.zeros(len(steps)))
    return scored(hill, neighbours, one.fit.values)

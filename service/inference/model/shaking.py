"""What lies about the best pose of a search: sides of its panels, bottoms of its valley (docs/model.md, 4)."""

from __future__ import annotations

import numpy as np

from service.inference.model.candidates import Candidates, best_of_each, joined, scored, searched_joints
from service.inference.model.drawing import Drawing
from service.inference.model.stages import FINEST
from service.inference.numerics.gauss_newton import ascend, stepped
from service.inference.numerics.hill import Hill, Refined
from service.inference.numerics.priors import PosePrior
from service.inference.pose import concatenate
from service.inference.state import Array

# numerical: poses about one that does not fit, how far about it they lie, how far along
_SHAKEN, _SHAKEN_RAD, _ALONG_RAD = 24, 0.12, 0.2
_SHAKEN_PLACE, _SHAKEN_SCALE = 0.1, 0.2  # numerical: of that angle, place in radii of the body, log scale
_TURNED, _ABOUT, _ALONG, _KEPT = 2, 2, 5, 2  # numerical: of each kind, how many are tried; how many climb to the end
_TRIAL_STEPS = 2  # numerical: of the finest stage
_BETTER = 1.0  # numerical: nats by which a basin may be bettered without another look
# numerical: by which joints are turned
_TURNS_DEG = (-90.0, -60.0, -30.0, -15.0, 15.0, 30.0, 60.0, 90.0, 180.0)


def shaken(clear: Hill, hill: Hill, one: Refined, doubted: bool = False) -> list[Refined]:
    """The best of what lies about a pose, if it is better or elsewhere: with one joint turned, whose evidence has many
    tops, from each side of a panel and wherever its edge lies on another's, and only fine pictures tell them.

    ``clear``: where they are chosen, which costs half; they climb on ``hill`` alone, where the pose was refined: on a
    clear hill they end in other valleys.
    ``doubted``: it does not fit. Then some lie some degrees about it in every direction, more along its own covariance,
    widened: turn, place and size make up for each other, and such a valley may have several bottoms.
    """
    kinds = [(turns_of_joints(hill, 6 + one.pose.joints.shape[1]), _TURNED)]
    if doubted:
        kinds += zip(_about_and_along(hill, one), (_ABOUT, _ALONG), strict=True)
    several = [neighbours(clear, one, steps)[:most] for steps, most in kinds if len(steps)]
    if not several:
        return []
    near = joined(several)
    light = np.tile(one.fit.values, (len(near), 1))
    out = ascend(hill, near.poses, near.suns, steps=_TRIAL_STEPS, covariance="none", near=light)
    out = sorted(out, key=lambda tried: -tried.log_posterior)[:_KEPT]
    out = [tried for tried in out if tried.log_posterior > one.log_posterior + _BETTER or apart(hill, tried, one)]
    if not out:
        return []
    poses, suns = concatenate(*[tried.pose for tried in out]), np.stack([tried.sun for tried in out])
    light = np.stack([tried.fit.values for tried in out])
    return ascend(hill, poses, suns, steps=FINEST.steps, covariance="last", near=light)


def _about_and_along(hill: Hill, one: Refined) -> tuple[Array, Array]:
    """(N, d) steps each."""
    drawn = np.random.default_rng(_SHAKEN).standard_normal((2, _SHAKEN, 6 + one.pose.joints.shape[1]))
    about, along = drawn[0], drawn[1]
    about[:, :3] *= _SHAKEN_RAD
    about[:, 3:5] *= _SHAKEN_PLACE * _SHAKEN_RAD * hill.drawing.radius * np.exp(one.pose.log_scale)
    about[:, 5] *= _SHAKEN_SCALE * _SHAKEN_RAD
    about[:, 6:] *= np.rad2deg(_SHAKEN_RAD)
    values, vectors = np.linalg.eigh(one.covariance)
    turn = np.sqrt(np.linalg.eigvalsh(one.covariance[:3, :3])[-1])
    return about, along * np.sqrt(np.maximum(values, 0.0)) @ vectors.T * (_ALONG_RAD / turn)


def turning_joints(drawing: Drawing, told: PosePrior) -> list[int]:
    """Columns of joints that turn, and of which nothing is known."""
    joints = drawing.articulation.joints
    return [k for k in searched_joints(drawing, told) if joints[k].kind == "revolute"]


def turns_of_joints(hill: Hill, d: int) -> Array:
    """(N, d) steps of one joint each."""
    out = [np.zeros((0, d))]
    for k in turning_joints(hill.drawing, hill.told):
        out.append(np.zeros((len(_TURNS_DEG), d)))
        out[-1][:, 6 + k] = _TURNS_DEG
    return np.concatenate(out)


def apart(hill: Hill, one: Refined, other: Refined) -> bool:
    """Whether two poses are two basins."""
    return len(best_of_each([one, other], hill.drawing.articulation.round_axes)) > 1


def neighbours(hill: Hill, one: Refined, steps: Array) -> Candidates:
    """A pose moved by steps (N, d), best first."""
    start = one.pose[np.zeros(len(steps), dtype=np.intp)]
    moved = Candidates(stepped(hill.drawing, start, steps), np.tile(one.sun, (len(steps), 1)), np.zeros(len(steps)))
    return scored(hill, moved, one.fit.values)

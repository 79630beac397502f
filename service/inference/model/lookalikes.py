"""Poses beside those that a search has met: what looks alike, and what lies around (docs/model.md, section 4)."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from service.inference.model.candidates import Candidates, climbed, scored
from service.inference.model.stages import SHARP
from service.inference.numerics.gauss_newton import stepped
from service.inference.numerics.hill import Hill
from service.inference.pose import concatenate
from service.inference.state import Poses
from service.inference.symmetry import Symmetry, twin

# numerical: poses about a leader that does not fit, how far each axis, steps; place (radii) and log scale
_SCATTERED, _SCATTERED_RAD, _SCATTERED_STEPS, _SCATTERED_PLACE = 32, 0.15, 5, 0.015
_CLIMBING = 4  # numerical: of the images of a box, the best that climb
BETWEEN_JOINTS = 0.06  # numerical: of a joint's range, about half of what lies between the values of a bank
_SIGNS = tuple(itertools.product((1.0, -1.0), repeat=3))[1:]  # of a box's own axes: what maps it onto itself
_AWAY = np.array([1.0, 1.0, -1.0])  # exact: a Sun in front, seen behind


def equivalents(some: Candidates, alike: Callable[[Poses], Poses]) -> Candidates:
    """Poses of the same outlines, not looked at."""
    poses = alike(some.poses)
    suns = np.tile(some.suns, (len(poses) // len(some.poses), 1))
    return Candidates(poses, suns, np.full(len(poses), -np.inf))


def boxed(hill: Hill, some: Candidates) -> Candidates:
    """What poses would look like, were the body a box along its own axes, the best climbed: a spacecraft is nearly one.

    R S for half a turn S about an axis, Z R S for a reflection, with Z = diag(1, 1, -1): seven of each pose.
    """
    still, same = (1.0,) * some.poses.joints.shape[1], (0.0,) * some.poses.joints.shape[1]
    poses, suns = [], []
    for x, y, z in _SIGNS:
        poses.append(twin(some.poses, Symmetry(((x, 0.0, 0.0), (0.0, y, 0.0), (0.0, 0.0, z)), (0.0,) * 3, still, same)))
        suns.append(some.suns * _AWAY if x * y * z < 0 and hill.told.towards_sun is None else some.suns)
    alike = Candidates(concatenate(*poses), np.concatenate(suns), np.zeros(len(_SIGNS) * len(some.poses)))
    return climbed(hill, scored(hill, alike), replace(SHARP, kept=_CLIMBING))


def scattered(rng: np.random.Generator, hill: Hill, one: Candidates) -> Candidates:
    """What poses in a wide ball about one climb to: while pictures were coarse all of them slid to where it is."""
    steps = rng.standard_normal((_SCATTERED, 6 + one.poses.joints.shape[1]))
    rim = hill.drawing.radius * np.exp(one.poses.log_scale)
    steps[:, :3] *= _SCATTERED_RAD
    steps[:, 3:5] *= _SCATTERED_PLACE * rim
    steps[:, 5] *= _SCATTERED_PLACE
    steps[:, 6:] *= BETWEEN_JOINTS * hill.drawing.articulation.spans
    at = np.zeros(_SCATTERED, np.intp)
    moved = stepped(hill.drawing, one.poses[at], steps)
    about = Candidates(moved, one.suns[at], np.zeros(_SCATTERED))
    return climbed(hill, about, replace(SHARP, kept=_SCATTERED, steps=_SCATTERED_STEPS))

"""Bodies of revolution: a turn about their axis changes nothing that can be seen, so nothing is known of it.

``axes`` are unit vectors of the body frame: none, one of a rocket stage, several of a ball, of which no turn is known.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from service.inference.pose import (
    angle_between,
    any_turns,
    concatenate,
    directions_apart,
    exp_so3,
    multiply,
    rotation_matrices,
)
from service.inference.state import Array, Poses

Axis = tuple[float, float, float]

_ANY_ANGLE = np.pi**2 / 3  # exact: rad², variance of an angle that may be any
_ANY_TURN = (np.pi**2 / 3 + 2) / 3  # exact: rad² each axis, of a turn that may be any (Haar measure)
# numerical: which of the axes, how many turns about it: of none, of one, of a ball
_TURNS = ((), ((0, 16),), ((0, 4), (1, 4), (0, 4)))


def angle_apart(a: Array, b: Array, axes: Sequence[Axis]) -> Array:
    """Radians between quaternions (..., 4), after the turns about the axes that bring them nearest.

    What is left of R_a and R_b after a free turn about n is the angle between R_a n and R_b n.
    """
    if not axes:
        return angle_between(a, b)
    if len(axes) > 1:
        return np.zeros(np.broadcast_shapes(a.shape, b.shape)[:-1])
    return directions_apart(rotation_matrices(a) @ axes[0], rotation_matrices(b) @ axes[0])


def turned_within(quaternions: Array, apart: float, axes: Sequence[Axis]) -> NDArray[np.bool_]:
    """(N, N) which of N quaternions are no more than ``apart`` (rad) from each other, as ``angle_apart`` tells it."""
    if not axes:
        near = np.cos(0.5 * apart)  # of the angle between two quaternions that far apart
        return np.asarray(np.abs(quaternions @ quaternions.T) >= near)
    if len(axes) > 1:
        return np.ones((len(quaternions),) * 2, dtype=bool)
    directions = rotation_matrices(quaternions) @ axes[0]
    return np.asarray(directions @ directions.T >= np.cos(apart))


def turned_freely(rng: np.random.Generator, quaternion: Array, axes: Sequence[Axis]) -> Array:
    """(N, 4) the same, each turned about the axes by an angle that may be any."""
    if not axes:
        return quaternion
    if len(axes) > 1:
        return any_turns(rng, len(quaternion))
    angle = rng.uniform(-np.pi, np.pi, (len(quaternion), 1))
    return multiply(quaternion, exp_so3(angle * np.array(axes[0])))


def with_free_turn(covariance: Array, axes: Sequence[Axis]) -> Array:
    """(d, d), the body-side rotation first (rad): about the axes it is that of any angle, alone."""
    if not axes:
        return covariance
    known = np.eye(len(covariance))
    free = np.zeros_like(covariance)
    if len(axes) > 1:
        known[:3, :3] = 0.0
        free[:3, :3] = _ANY_TURN * np.eye(3)
    else:
        along = np.outer(axes[0], axes[0])
        known[:3, :3] -= along
        free[:3, :3] = _ANY_ANGLE * along
    return np.asarray(known @ covariance @ known + free)


def turned_round(poses: Poses, axes: Sequence[Axis]) -> Poses:
    """The N poses, each at turns about the axes that are spread evenly (16 N or, of a ball, 64 N)."""
    for axis, count in _TURNS[min(len(axes), 2)]:
        angles = 2 * np.pi / count * np.arange(count)
        turns = [multiply(poses.quaternion, exp_so3(angle * np.array(axes[axis]))) for angle in angles]
        poses = concatenate(*(replace(poses, quaternion=turn) for turn in turns))
    return poses

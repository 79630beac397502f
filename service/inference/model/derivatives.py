"""Derivatives of a drawn and blurred picture by what draws it (docs/model.md, section 3).

A body that moves across, grows, or turns about the line of sight gives the same picture elsewhere; in the last case
under a Sun that turns the other way. Only turns about the image's own axes, joints and the Sun are drawn. Through a
lens that is not so: then everything is drawn.
"""

from __future__ import annotations

from math import sqrt

import numpy as np
from numpy.typing import NDArray

from service.inference.model.drawing import Drawing, Images, Quality, View
from service.inference.model.spread import PointSpread, spread, spread_slopes
from service.inference.pose import concatenate, retract, rotation_matrices
from service.inference.state import Array, Poses

_SUN_STEP = 0.03  # numerical: rad of a difference


def across(direction: Array) -> Array:
    """(2, 3) unit vectors across a direction and each other."""
    x, y, z = (float(v) for v in direction)  # a few numbers: NumPy's own product takes forty times as long
    aside = int(np.argmin(np.abs(direction)))  # the first is the direction times this axis
    a, b, c = ((0.0, z, -y), (-z, 0.0, x), (y, -x, 0.0))[aside]
    length = sqrt(a * a + b * b + c * c)
    a, b, c = a / length, b / length, c / length
    return np.array([[a, b, c], [y * c - z * b, z * a - x * c, x * b - y * a]])


def steps_of(drawing: Drawing, view: View, difference: float, poses: Poses) -> tuple[Array, Array]:
    """(N,) turns (rad) and (N, J) joint values by which a pose differs: the rim moves by ``difference`` patch px."""
    rim = np.maximum(drawing.radius * np.exp(poses.log_scale) / view.binning, 1.0)
    turn = difference / rim
    joints = [
        np.rad2deg(2 * turn) if joint.kind == "revolute" else turn * drawing.radius
        for joint in drawing.articulation.joints
    ]
    return turn, np.column_stack(joints) if joints else np.zeros((len(poses), 0))


def derivatives(
    drawing: Drawing,
    view: View,
    quality: Quality,
    blur: tuple[PointSpread, float],
    poses: Poses,
    suns: Array,
    coefficients: Images,
    difference: float,
    sun_free: bool,
) -> Images:
    """(N, D, S, S) of K * I by rotation (body side, rad), place (frame px), log scale, joints, and the Sun's two axes.

    ``suns`` (N, 3), ``coefficients`` (N, Q) of the planes; ``blur``: point spread and low pass. The Sun's are given
    where it is free. Differences are central.
    """
    n, j = len(poses), poses.joints.shape[1]
    turn, joint = steps_of(drawing, view, difference, poses)
    if view.lens is not None:
        place = np.full((n, 2), difference * view.binning)
        steps = np.concatenate([np.repeat(turn[:, None], 3, 1), place, turn[:, None], joint], axis=1)
        return _through_lens(drawing, view, quality, blur, poses, suns, coefficients, steps, sun_free)
    rotation = rotation_matrices(poses.quaternion)
    turned = 2 if sun_free else 3  # axes of the camera about which a turn is drawn
    suns_moved = 2 if sun_free else 0
    drawn = turned + j + suns_moved
    moves = np.zeros((n, 2, drawn, 6 + j))
    for k in range(turned):
        moves[:, 0, k, :3] = turn[:, None] * rotation[:, k]  # about the camera's axis k, seen from the body
    moves[:, 0, turned + np.arange(j), 6 + np.arange(j)] = joint
    moves[:, 1] = -moves[:, 0]
    moved_suns = _suns_of(suns, drawn, sun_free)
    start = poses[np.repeat(np.arange(n), 2 * drawn)]
    moved = concatenate(retract(start, moves.reshape(-1, 6 + j)), poses)
    shares = np.concatenate([np.repeat(coefficients, 2 * drawn, axis=0), coefficients])
    images = drawing.combined(moved, np.concatenate([moved_suns.reshape(-1, 3), suns]), shares, view, quality)
    images, here = images[:-n].reshape(n, 2, drawn, view.side, view.side), images[-n:]
    gaps = np.concatenate([np.repeat(turn[:, None], turned, 1), joint, np.full((n, suns_moved), _SUN_STEP)], axis=1)
    slopes = spread((images[:, 0] - images[:, 1]) * _per(0.5 / gaps), *blur)
    return _assembled(slopes, _of_places(here, blur, poses, view), rotation, suns, view, sun_free, j)


def _suns_of(suns: Array, drawn: int, sun_free: bool) -> Array:
    """(N, 2, drawn, 3) Suns of differences, of which the last two are the Sun's own where it is free."""
    out = np.tile(suns[:, None, None], (1, 2, drawn, 1))
    for k, sun in enumerate(suns if sun_free else ()):
        both = np.stack([sun + _SUN_STEP * across(sun), sun - _SUN_STEP * across(sun)])
        out[k, :, -2:] = both / np.linalg.norm(both, axis=-1, keepdims=True)
    return out


def _through_lens(
    drawing: Drawing,
    view: View,
    quality: Quality,
    blur: tuple[PointSpread, float],
    poses: Poses,
    suns: Array,
    coefficients: Images,
    steps: Array,
    sun_free: bool,
) -> Images:
    """``derivatives`` of which all are differences; ``steps`` (N, 6 + J) of the pose."""
    n, d = steps.shape
    suns_moved = 2 if sun_free else 0
    drawn = d + suns_moved
    moves = np.zeros((n, 2, drawn, d))
    moves[:, 0, np.arange(d), np.arange(d)] = steps
    moves[:, 1] = -moves[:, 0]
    moved = retract(poses[np.repeat(np.arange(n), 2 * drawn)], moves.reshape(-1, d))
    shares = np.repeat(coefficients, 2 * drawn, axis=0)
    images = drawing.combined(moved, _suns_of(suns, drawn, sun_free).reshape(-1, 3), shares, view, quality)
    images = images.reshape(n, 2, drawn, view.side, view.side)
    gaps = np.concatenate([steps, np.full((n, suns_moved), _SUN_STEP)], axis=1)
    return spread((images[:, 0] - images[:, 1]) * _per(0.5 / gaps), *blur)


def _of_places(here: Images, blur: tuple[PointSpread, float], poses: Poses, view: View) -> Images:
    """(N, 4, S, S): what K * I loses by x and y (patch px), by growth, and by a turn of the picture from x to y."""
    middle = (poses.position - np.asarray(view.origin)) / view.binning
    grid = np.arange(view.side) + 0.5
    x = (grid[None, None, :] - middle[:, 0, None, None]).astype(np.float32)
    y = (grid[None, :, None] - middle[:, 1, None, None]).astype(np.float32)
    blurred, dx, dy = spread_slopes(np.stack([here, x * here, y * here], axis=1), *blur)
    return np.stack(
        [-dx[:, 0], -dy[:, 0], 2 * blurred[:, 0] - dx[:, 1] - dy[:, 2], dx[:, 2] - dy[:, 1]], axis=1, dtype=np.float32
    )


def _assembled(
    slopes: Images, places: Images, rotation: Array, suns: Array, view: View, sun_free: bool, j: int
) -> Images:
    """Turns about the camera's axes are told as turns of the body; the third is the picture's and the Sun's."""
    n, _, side, _ = slopes.shape
    turns = slopes[:, : 2 if sun_free else 3]
    if sun_free:
        turned = np.stack([suns[:, 1], -suns[:, 0], np.zeros(n)], axis=1)  # suns x the line of sight
        aside = np.stack([across(sun) @ moved for sun, moved in zip(suns, turned, strict=True)]).astype(np.float32)
        third = places[:, 3] + np.einsum("nk,nkyx->nyx", aside, slopes[:, -2:])
        turns = np.concatenate([turns, third[:, None]], axis=1)
    body = np.matmul(np.swapaxes(rotation, 1, 2).astype(np.float32), turns.reshape(n, 3, -1)).reshape(n, 3, side, side)
    more = slopes[:, -(j + 2) :] if sun_free else slopes[:, 3:]
    return np.concatenate([body, places[:, :2] / np.float32(view.binning), places[:, 2:3], more], axis=1)


def _per(values: Array) -> NDArray[np.float32]:
    return np.asarray(values, np.float32)[..., None, None]

"""Derivatives of a drawn and blurred picture by what draws it (docs/model.md, section 3).

A body that moves across, grows, or turns about the line of sight gives the same picture elsewhere; in the last case
under a Sun that turns the other way. Only turns about the image's own axes, joints and the Sun are drawn. Through a
lens that is not so: then everything is drawn.
"""

from __future__ import annotations

from math import sqrt

import numpy as np

from service.inference.model.drawing import Drawing, Images, Quality, View
from service.inference.model.spread import PointSpread, gaussians_and_slopes, spread, spread_slopes
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


def turns_drawn(view: View, sun_free: bool) -> int:
    """Axes of the camera about which a turn is drawn: not the line of sight, where the Sun's own moves are drawn.

    But there where the Earth shines from a side: it would have to turn, too.
    """
    return 2 if sun_free and not any(view.around[:2]) else 3


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
    rotation = rotation_matrices(poses.quaternion)
    if view.lens is None:
        turned = turns_drawn(view, sun_free)
        steps = np.concatenate([np.repeat(turn[:, None], turned, 1), joint], axis=1)
        moves = np.zeros((n, turned + j, 6 + j))
        moves[:, :turned, :3] = turn[:, None, None] * rotation[:, :turned]  # about the camera's, seen from the body
        moves[:, turned + np.arange(j), 6 + np.arange(j)] = joint
    else:
        place = np.full((n, 2), difference * view.binning)
        steps = np.concatenate([np.repeat(turn[:, None], 3, 1), place, turn[:, None], joint], axis=1)
        moves = steps[:, :, None] * np.eye(6 + j)
    pairs, here = _drawn(drawing, view, quality, poses, suns, coefficients, moves, sun_free)
    gaps = np.concatenate([steps, np.full((n, pairs.shape[2] - steps.shape[1]), _SUN_STEP)], axis=1)
    if view.lens is None:
        mixes = _mixes(rotation, suns, j, view, turned, sun_free)
    else:
        mixes = np.tile(np.eye(gaps.shape[1]), (n, 1, 1))
    mixes[:, :, : gaps.shape[1]] *= 0.5 / gaps[:, None]
    middles = (poses.position - np.asarray(view.origin)) / view.binning
    if drawing.slopes is None:
        return mixed(pairs, here, middles, mixes, blur)
    gaussians = gaussians_and_slopes(view.side, *blur)
    return drawing.slopes.mixed(pairs, here, middles, mixes, gaussians)


def _drawn(
    drawing: Drawing,
    view: View,
    quality: Quality,
    poses: Poses,
    suns: Array,
    coefficients: Images,
    moves: Array,
    sun_free: bool,
) -> tuple[Images, Images | None]:
    """(N, 2, K, S, S) on both sides of ``moves`` (N, K', 6 + J), and of the Sun's where it is free; and between them.

    Through a lens nothing is asked of what is between.
    """
    n, turned, d = moves.shape
    drawn = turned + (2 if sun_free else 0)
    both = np.zeros((n, 2, drawn, d))
    both[:, 0, :turned], both[:, 1, :turned] = moves, -moves
    moved = retract(poses[np.repeat(np.arange(n), 2 * drawn)], both.reshape(-1, d))
    moved_suns = _suns_of(suns, drawn, sun_free).reshape(-1, 3)
    shares = np.repeat(coefficients, 2 * drawn, axis=0)
    if view.lens is None:
        moved, moved_suns = concatenate(moved, poses), np.concatenate([moved_suns, suns])
        shares = np.concatenate([shares, coefficients])
    images = drawing.combined(moved, moved_suns, shares, view, quality)
    pairs = images[: 2 * drawn * n].reshape(n, 2, drawn, view.side, view.side)
    return pairs, images[2 * drawn * n :] if view.lens is None else None


def _mixes(rotation: Array, suns: Array, j: int, view: View, turned: int, sun_free: bool) -> Array:
    """(N, D, K + 4) what each derivative is of the K that are drawn and of the four of ``_of_places``.

    Turns about the camera's axes are told as turns of the body; the third is the picture's and the Sun's.
    """
    n, suns_moved = len(suns), 2 if sun_free else 0
    drawn = turned + j + suns_moved
    camera = np.zeros((n, 3, drawn + 4))
    camera[:, range(turned), range(turned)] = 1.0
    if turned < 3:
        aside = np.stack([suns[:, 1], -suns[:, 0], np.zeros(n)], axis=1)  # suns x the line of sight
        camera[:, 2, turned + j : drawn] = [across(sun) @ moved for sun, moved in zip(suns, aside, strict=True)]
        camera[:, 2, drawn + 3] = 1.0
    out = np.zeros((n, 6 + j + suns_moved, drawn + 4))
    out[:, :3] = np.swapaxes(rotation, 1, 2) @ camera
    out[:, [3, 4], [drawn, drawn + 1]] = 1.0 / view.binning
    out[:, 5, drawn + 2] = 1.0
    out[:, range(6, 6 + j + suns_moved), range(turned, drawn)] = 1.0
    return out


def mixed(pairs: Images, here: Images | None, middles: Array, mixes: Array, blur: tuple[PointSpread, float]) -> Images:
    """(N, D, S, S): the twin of ``gpu.slopes.LightSlopes.mixed``, which says what it is given."""
    parts = spread(pairs[:, 0] - pairs[:, 1], *blur)
    if here is not None:
        parts = np.concatenate([parts, _of_places(here, middles, blur)], axis=1)
    n, count, side, _ = parts.shape
    out = mixes.astype(np.float32) @ parts.reshape(n, count, side * side)
    return np.asarray(out, np.float32).reshape(n, -1, side, side)


def _suns_of(suns: Array, drawn: int, sun_free: bool) -> Array:
    """(N, 2, drawn, 3) Suns of differences, of which the last two are the Sun's own where it is free."""
    out = np.tile(suns[:, None, None], (1, 2, drawn, 1))
    for k, sun in enumerate(suns if sun_free else ()):
        both = np.stack([sun + _SUN_STEP * across(sun), sun - _SUN_STEP * across(sun)])
        out[k, :, -2:] = both / np.linalg.norm(both, axis=-1, keepdims=True)
    return out


def _of_places(here: Images, middles: Array, blur: tuple[PointSpread, float]) -> Images:
    """(N, 4, S, S): what K * I loses by x and y (patch px), by growth, and by a turn of the picture from x to y."""
    grid = np.arange(here.shape[-1]) + 0.5
    x = (grid[None, None, :] - middles[:, 0, None, None]).astype(np.float32)
    y = (grid[None, :, None] - middles[:, 1, None, None]).astype(np.float32)
    blurred, dx, dy = spread_slopes(np.stack([here, x * here, y * here], axis=1), *blur)
    return np.stack(
        [-dx[:, 0], -dy[:, 0], 2 * blurred[:, 0] - dx[:, 1] - dy[:, 2], dx[:, 2] - dy[:, 1]], axis=1, dtype=np.float32
    )

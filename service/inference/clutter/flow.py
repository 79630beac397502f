"""How a body moved, told by the texture on it: points of one picture found again in the next (docs/model.md, 7)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from service.inference.articulation import Articulation, part_transforms
from service.inference.model.drawing import Lens
from service.inference.model.prior import DEGREES_OF_FREEDOM
from service.inference.pose import repeat, retract
from service.inference.state import Array, Poses

Picture = NDArray[np.uint8]
_MOST, _LEAST = 200, 8  # numerical: points; fewer tell no pose
_QUALITY, _BETWEEN_PX = 0.005, 4  # numerical: of a corner against the best; between two
_WINDOW, _WINDOW_PX, _LEVELS = 0.1, (9, 21), 4  # numerical: of Lucas and Kanade's search: share of the picture
_BACK_PX = 1.0  # numerical: by how much a point that is followed back may miss where it began
_POINT_PX = 1.0  # prior: by how much a point that was found again is off
_ALIKE = 8.0  # prior: points that err alike: mesh and pose that they were lifted by are wrong for all of them
_DRIFT_RAD, _DRIFT_PX, _DRIFT_SCALE, _DRIFT_JOINT = 0.01, 0.5, 0.005, 0.01  # prior: of one frame's flow, beside it
_ROUNDS, _START_PX = 12, 6.0  # numerical: of reweighting; the first one's scale
_STEP = 1e-3  # numerical: of the differences, of the body's size; poses are drawn in single precision


@dataclass(frozen=True)
class Followed:
    """N points, frame px: where they were, and where they are."""

    before: Array  # (N, 2)
    after: Array  # (N, 2)


@dataclass(frozen=True)
class OnBody:
    """N points of a body at rest, and which part each is on; -1: none."""

    points: Array  # (N, 3)
    part: NDArray[np.intp]


Lift = Callable[[Poses, Array], OnBody]  # a pose (1), places (N, 2) in frame px


def follow(before: Picture, after: Picture, inside: NDArray[np.bool_], corner: Array) -> Followed | None:
    """Corners of what is ``inside`` a picture (H, W), found again in the next one; ``corner``: of both, frame px.

    Shi and Tomasi's corners, Lucas and Kanade's search, forth and back. None: too few.
    """
    some: Any = cv2.goodFeaturesToTrack(before, _MOST, _QUALITY, _BETWEEN_PX, mask=inside.astype(np.uint8))
    if some is None or len(some) < _LEAST:
        return None
    side = int(np.clip(_WINDOW * len(before), *_WINDOW_PX)) | 1
    flow: Any = cv2.calcOpticalFlowPyrLK  # its types forbid that no guess is given
    there, seen, _ = flow(before, after, some, None, winSize=(side, side), maxLevel=_LEVELS)
    back, again, _ = flow(after, before, there, None, winSize=(side, side), maxLevel=_LEVELS)
    good = (seen[:, 0] > 0) & (again[:, 0] > 0) & (np.linalg.norm((back - some)[:, 0], axis=1) < _BACK_PX)
    if np.count_nonzero(good) < _LEAST:
        return None
    first, last = (points[good, 0].astype(np.float64) + corner + 0.5 for points in (some, there))
    return Followed(first, last)


@dataclass(frozen=True)
class Moved:
    """A pose as its texture has moved."""

    pose: Poses  # (1)
    covariance: Array  # (d, d)
    nats: float  # log likelihood of the points, so many counted as one as err alike


def moved(
    articulation: Articulation, pose: Poses, lens: Lens | None, on_body: OnBody, followed: Followed
) -> Moved | None:
    """The pose (1) under which a body's points are seen where they were found; None: too few are on it.

    Gauss-Newton on the reprojection error, Student t: its scale falls from that of wrong matches to that of right ones.
    """
    held = on_body.part >= 0
    if np.count_nonzero(held) < _LEAST:
        return None
    points, part, goal = on_body.points[held], on_body.part[held], followed.after[held]
    d = 6 + pose.joints.shape[1]
    size = float(np.exp(pose.log_scale[0])) * max(float(np.abs(points).max()), 1e-12)
    unit = np.concatenate([np.full(3, 1.0), np.full(2, size), [1.0], np.maximum(articulation.spans, 1e-9)])
    known = np.diag(1 / unit**2)  # a direction that no point tells stays
    for scale in np.maximum(np.geomspace(_START_PX, _POINT_PX, _ROUNDS), _POINT_PX):
        steps = np.concatenate([np.zeros((1, d)), _STEP * np.diag(unit)])
        at = _seen(articulation, retract(repeat(pose, d + 1), steps), lens, points, part)
        slopes = (at[1:] - at[0]) / (_STEP * unit)[:, None, None]
        off = goal - at[0]
        square = (off**2).sum(axis=1) / scale**2
        weight = (DEGREES_OF_FREEDOM + 2) / (DEGREES_OF_FREEDOM + square) / scale**2
        normal = np.einsum("n,dni,eni->de", weight, slopes, slopes) + known
        pose = retract(pose, np.linalg.solve(normal, np.einsum("n,dni,ni->d", weight, slopes, off))[None])
    at = _seen(articulation, pose, lens, points, part)[0]
    square = ((goal - at) ** 2).sum(axis=1) / _POINT_PX**2
    t = -0.5 * (DEGREES_OF_FREEDOM + 2) * np.log1p(square / DEGREES_OF_FREEDOM)
    drift = np.concatenate(
        [np.full(3, _DRIFT_RAD), np.full(2, _DRIFT_PX), [_DRIFT_SCALE], _DRIFT_JOINT * articulation.spans]
    )
    nats = float(t.mean()) * len(followed.after) / _ALIKE  # points that are not on it count as those that are
    return Moved(pose, _ALIKE * np.linalg.inv(normal) + np.diag(drift**2), nats)


def _seen(articulation: Articulation, poses: Poses, lens: Lens | None, points: Array, part: NDArray[np.intp]) -> Array:
    """(M, N, 2) where N points of a body at rest are seen at M poses."""
    transforms = part_transforms(articulation, poses).astype(np.float64)[:, part]
    placed = np.einsum("mnij,nj->mni", transforms[..., :3], points) + transforms[..., 3]
    return placed[..., :2] if lens is None else lens.seen(placed)

"""Quick small silhouettes of a body, to ask whether two poses look alike."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from gpu.mesh import Mesh, Part
from service.inference.articulation import Articulation, part_transforms
from service.inference.state import Array, Poses

Masks = NDArray[np.bool_]

SIZE_PX = 128
QUICK_SIZE_PX = 40
QUICK_POINTS = 12_000
_FILL = 0.42  # radius of what is looked at, as a share of the image
_SHIFT_BITS = 4  # OpenCV's fixed point: sixteenths of a pixel
_SURELY_SMALL_PX = 0.93  # a face with no longer edge is small however it is rounded to sixteenths

# What drawing takes at most, in nanoseconds of a slow core. Nine spacecraft took at most 4e9 (the ISS, 14 joints).
MOST_WORK = 1e10
_WORK_OF_MASK, _WORK_OF_PART, _WORK_OF_POINT, _WORK_OF_FACE = 1e6, 1e4, 50, 2e3


class TooIntricateError(Exception):
    """Drawing the body again and again would take too long."""


@dataclass(frozen=True)
class Target:
    """What a view is centred on: a body point, and how far to see around it."""

    centre: Array  # (3,)
    radius: float


class Silhouettes:
    """Draws some or all parts of a body from fixed directions; the same every time."""

    def __init__(self, mesh: Mesh, articulation: Articulation, n_views: int = 6) -> None:
        self.mesh, self.articulation = mesh, articulation
        quaternion = np.random.default_rng(1906).standard_normal((n_views, 4))
        self.quaternion = quaternion / np.linalg.norm(quaternion, axis=1, keepdims=True)
        areas = [_areas(part) for part in mesh.parts]
        density = QUICK_POINTS / sum(float(a.sum()) for a in areas)
        self.points = [surface_points(p, a, density) for p, a in zip(mesh.parts, areas, strict=True)]
        self._edges = [_longest_edges(part) for part in mesh.parts]
        self._firsts = np.cumsum([0, *(len(part.vertices) for part in mesh.parts)])  # their vertices, one after another
        self._work = 0.0

    def poses(self, joints: Array, target: Target, size_px: int = SIZE_PX) -> Poses:
        """One pose per view with joint values (K, J) or (J,), ``target`` in the middle of the image."""
        count = len(self.quaternion)
        scale = _FILL * size_px / target.radius
        still = Poses(self.quaternion, np.zeros((count, 2)), np.full(count, np.log(scale)), np.zeros((count, 0)))
        camera = part_transforms(Articulation(("body",)), still)[:, 0].astype(np.float64)
        middle = (camera[:, :2, :3] @ target.centre) + camera[:, :2, 3]
        values = np.broadcast_to(joints, (count, self.articulation.n_joints))
        return Poses(self.quaternion, 0.5 * size_px - middle, still.log_scale, np.array(values, dtype=np.float64))

    def draw(self, poses: Poses, parts: Sequence[int] | None = None) -> Masks:
        """(N, SIZE_PX, SIZE_PX) pixels that the parts (all by default) touch. Raises ``TooIntricateError``."""
        chosen = range(len(self.mesh.parts)) if parts is None else parts
        large, small = self._split(chosen, float(np.exp(poses.log_scale.max(initial=-np.inf))))
        n_vertices = sum(len(self.mesh.parts[p].vertices) for p in chosen)
        self._spend(len(poses), len(chosen), n_vertices, len(large))
        masks = np.zeros((len(poses), SIZE_PX, SIZE_PX), dtype=np.uint8)
        pixels = np.empty((self._firsts[-1], 2))
        for mask, transforms in zip(masks, part_transforms(self.articulation, poses), strict=True):
            for p in chosen:
                pixels[self._firsts[p] : self._firsts[p + 1]] = project(self.mesh.parts[p].vertices, transforms[p])
            _set(mask, _fixed(pixels[small]))
            _fill(mask, _fixed(pixels[large]))
        return masks.astype(bool)

    def _split(self, chosen: Sequence[int], scale: float) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """(F, 3) corners of the parts' faces that may be larger than a pixel, and the vertices of all others."""
        seen, large = np.zeros(self._firsts[-1], dtype=bool), [np.zeros((0, 3), np.int64)]
        for p in chosen:
            big = self._edges[p] * scale > _SURELY_SMALL_PX
            large.append(self.mesh.parts[p].faces[big] + self._firsts[p])
            seen[self.mesh.parts[p].faces[~big] + self._firsts[p]] = True
        return np.concatenate(large), np.flatnonzero(seen)

    def _spend(self, masks: int, parts: int, points: int, faces: int) -> None:
        """``points`` and ``faces`` of one mask. Raises ``TooIntricateError`` once all work is spent."""
        one = _WORK_OF_MASK + _WORK_OF_PART * parts + _WORK_OF_POINT * points + _WORK_OF_FACE * faces
        self._work += masks * one
        if self._work > MOST_WORK:
            raise TooIntricateError

    def sketch(self, poses: Poses, parts: Sequence[int] | None = None) -> Masks:
        """(N, QUICK_SIZE_PX, QUICK_SIZE_PX) pixels that points of the surface hit: rough, but some 20 times faster."""
        chosen = range(len(self.mesh.parts)) if parts is None else parts
        self._spend(len(poses), len(chosen), QUICK_POINTS, 0)
        masks = np.zeros((len(poses), QUICK_SIZE_PX, QUICK_SIZE_PX), dtype=bool)
        for mask, transforms in zip(masks, part_transforms(self.articulation, poses), strict=True):
            pixels = np.concatenate([project(self.points[p], transforms[p]) for p in chosen])
            column, row = np.floor(pixels).astype(np.int64).T
            seen = (column >= 0) & (column < QUICK_SIZE_PX) & (row >= 0) & (row < QUICK_SIZE_PX)
            mask[row[seen], column[seen]] = True
        return masks


def project(points: Array, transform: NDArray[np.float32]) -> Array:
    """(V, 3) body points -> (V, 2) pixels under a (3, 4) transform."""
    t = transform[:2].astype(np.float64)
    return np.asarray(points @ t[:, :3].T + t[:, 3])


def surface_points(part: Part, areas: Array, density: float) -> Array:
    """(n, 3) points spread evenly over a part's surface, ``density`` per unit of area, the same every time."""
    count = max(1, round(float(areas.sum()) * density))
    cumulative = np.cumsum(areas)
    steps = (np.arange(count) + 0.5) / count
    face = np.searchsorted(cumulative, steps * cumulative[-1], side="left")
    # The R2 sequence (M. Roberts, 2018) fills the unit square evenly; folded, it fills a triangle.
    u, v = np.modf(np.outer(np.arange(1, count + 1), [0.7548776662466927, 0.5698402909980532]))[0].T
    u, v = np.where(u + v > 1, 1 - u, u)[:, None], np.where(u + v > 1, 1 - v, v)[:, None]
    a, b, c = (part.vertices[part.faces[face, k]] for k in range(3))
    return np.asarray(a + u * (b - a) + v * (c - a))


def overlap(a: Masks, b: Masks) -> Array:
    """(N,) intersection over union of two stacks of masks; 1 where both are empty."""
    union = np.sum(a | b, axis=(1, 2))
    return np.asarray(np.where(union > 0, np.sum(a & b, axis=(1, 2)) / np.maximum(union, 1), 1.0))


def best_displacement(a: Masks, b: Masks) -> tuple[Array, Array]:
    """How far b's masks lie from a's: (N, 2) x, y in px where they overlap most, and (N,) that overlap's IoU."""
    size = a.shape[1:]
    padded = (2 * size[0], 2 * size[1])
    spectrum = np.conj(np.fft.rfft2(a.astype(np.float64), padded)) * np.fft.rfft2(b.astype(np.float64), padded)
    shared = np.fft.irfft2(spectrum, padded)
    n = np.arange(len(a))
    row, column = np.unravel_index(shared.reshape(len(a), -1).argmax(axis=1), padded)
    peak = shared[n, row, column]
    y = row + _vertex(shared[n, row - 1, column], peak, shared[n, (row + 1) % padded[0], column])
    x = column + _vertex(shared[n, row, column - 1], peak, shared[n, row, (column + 1) % padded[1]])
    moved = np.stack([np.where(x > size[1], x - padded[1], x), np.where(y > size[0], y - padded[0], y)], axis=1)
    union = a.sum(axis=(1, 2)) + b.sum(axis=(1, 2)) - peak
    return moved, np.asarray(np.where(union > 0, peak / np.maximum(union, 1e-9), 1.0))


def _vertex(before: Array, peak: Array, after: Array) -> Array:
    """Where the parabola through three neighbours has its top, in (-0.5, 0.5)."""
    curvature = before - 2 * peak + after
    return np.asarray(np.where(curvature < 0, 0.5 * (before - after) / np.minimum(curvature, -1e-9), 0.0))


def _areas(part: Part) -> Array:
    a, b, c = (part.vertices[part.faces[:, k]] for k in range(3))
    return np.asarray(0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1))


def _longest_edges(part: Part) -> Array:
    a, b, c = (part.vertices[part.faces[:, k]] for k in range(3))
    return np.asarray(np.max([np.linalg.norm(edge, axis=1) for edge in (b - a, c - b, a - c)], axis=0))


def _fill(mask: NDArray[np.uint8], triangles: NDArray[np.int32]) -> None:
    """Draw faces (F, 3, 2) with their edges; what is smaller than a pixel as its corners, which is far quicker."""
    small = np.ptp(triangles, axis=1).max(axis=1) <= 1 << _SHIFT_BITS
    _set(mask, triangles[small].reshape(-1, 2))
    for triangle in triangles[~small]:
        cv2.fillConvexPoly(mask, triangle, 1, shift=_SHIFT_BITS)


def _fixed(pixels: Array) -> NDArray[np.int32]:
    return np.round((pixels - 0.5) * (1 << _SHIFT_BITS)).astype(np.int32)


def _set(mask: NDArray[np.uint8], points: NDArray[np.int32]) -> None:
    column, row = ((points + (1 << _SHIFT_BITS) // 2) >> _SHIFT_BITS).T
    height, width = mask.shape
    seen = (column >= 0) & (column < width) & (row >= 0) & (row < height)
    mask[row[seen], column[seen]] = 1

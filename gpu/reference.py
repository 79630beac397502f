"""The slow, obvious twin of every scorer: rasterise each face at pixel centres, then sum the map under the mask."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gpu.lens import Lens, seen_through
from gpu.mesh import Mesh, Part

Mask = NDArray[np.bool_]
Points = NDArray[np.float32]


def project(part: Part, transform: NDArray[np.float32]) -> NDArray[np.float32]:
    """(V, 2) pixel positions of a part's vertices under one (3, 4) transform.

    In float32 with the kernels' order of operations, so that twin and kernel decide about the same outline.
    """
    t = np.asarray(transform, dtype=np.float32)
    x, y, z = np.asarray(part.vertices, dtype=np.float32).T
    with np.errstate(all="ignore"):  # a pose that is no pose covers nothing
        return np.stack([((x * row[0] + y * row[1]) + z * row[2]) + row[3] for row in t[:2]], axis=1)


def silhouette_mask(
    mesh: Mesh, transforms: NDArray[np.float32], shape: tuple[int, int], lens: Lens | None = None
) -> Mask:
    """(H, W) True where a pixel's centre is covered by any face, of any orientation, of any part.

    ``transforms`` is (P, 3, 4), body point at rest -> (x px, y px, depth). A centre exactly on an edge belongs
    to the face on its right, or below it for a level edge: neighbours share no pixel and leave none out.
    ``lens``: of a pinhole camera.
    """
    height, width = shape
    layers = np.zeros(height * (width + 1), dtype=np.int64)  # faces that begin here, less those that end
    for part, transform in zip(mesh.parts, transforms, strict=True):
        to_centres = np.array(transform, dtype=np.float32)
        to_centres[:2, 3] -= np.float32(0.5)  # coordinates in which pixel (i, j) is the point (j, i)
        points = project(part, to_centres) if lens is None else _through(part, transform, lens)
        corners = points[part.faces]
        if np.isfinite(corners).all():
            row, first, end = _spans(corners, shape)
            layers += np.bincount(row * (width + 1) + first, minlength=len(layers))
            layers -= np.bincount(row * (width + 1) + end, minlength=len(layers))
    return np.asarray(layers.reshape(height, width + 1).cumsum(axis=1)[:, :width] > 0)


def _through(part: Part, transform: NDArray[np.float32], lens: Lens) -> Points:
    """``project`` before a pinhole camera, in coordinates in which pixel (i, j) is the point (j, i)."""
    placed = part.vertices @ transform[:, :3].T.astype(np.float64) + transform[:, 3]
    return (seen_through(placed, lens)[:, :2] - 0.5).astype(np.float32)


def _spans(corners: Points, shape: tuple[int, int]) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]:
    """(F, 3, 2) faces -> for every row of every face: the row, its first column, and the one after its last."""
    height, width = shape
    top, bottom = (_first_from(limit(corners[:, :, 1], axis=1), height) for limit in (np.min, np.max))
    face = np.repeat(np.arange(len(corners)), bottom - top)
    row: NDArray[np.int64] = np.arange(len(face)) - np.repeat(np.cumsum(bottom - top) - bottom, bottom - top)
    first, end = np.full(len(face), width), np.zeros(len(face), dtype=np.int64)
    for a, b in ((0, 1), (1, 2), (2, 0)):
        crossed, x = _crossing(corners[face, a], corners[face, b], row.astype(np.float32))
        column = _first_from(x, width)
        first[crossed] = np.minimum(first, column)[crossed]
        end[crossed] = np.maximum(end, column)[crossed]
    return row, first, end


def _crossing(a: Points, b: Points, y: NDArray[np.float32]) -> tuple[NDArray[np.bool_], NDArray[np.float32]]:
    """Which edges from a to b, (S, 2) each, cross the lines at y, and where; from the upper end on, as the kernels."""
    swap = (a[:, 1] > b[:, 1])[:, None]
    upper, lower = np.where(swap, b, a), np.where(swap, a, b)
    crossed = (y >= upper[:, 1]) & (y < lower[:, 1])
    slope = (lower[:, 0] - upper[:, 0]) / np.where(crossed, lower[:, 1] - upper[:, 1], np.float32(1.0))
    with np.errstate(over="ignore"):  # of edges that do not cross
        return crossed, np.asarray(upper[:, 0] + (y - upper[:, 1]) * slope, dtype=np.float32)


def _first_from(value: NDArray[np.float32], end: int) -> NDArray[np.int64]:
    """The first of the points 0, 1, 2, ... that is not before a coordinate, at most ``end``."""
    return np.ceil(np.clip(value, 0, end)).astype(np.int64)


def reference_scores(
    mesh: Mesh, part_transforms: NDArray[np.float32], maps: NDArray[np.float32] | NDArray[np.int32]
) -> NDArray[np.float64]:
    """(N, P, 3, 4) transforms and (K, H, W) maps -> (N, K) sums of each map under each silhouette."""
    values = np.asarray(maps, dtype=np.float64)
    scores = np.empty((len(part_transforms), len(values)))
    for n, transforms in enumerate(part_transforms):
        mask = silhouette_mask(mesh, transforms, (values.shape[1], values.shape[2]))
        scores[n] = values[:, mask].sum(axis=1)
    return scores

"""The slow, obvious twin of every scorer: rasterise each face at pixel centres, then sum the map under the mask."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gpu.mesh import Mesh, Part

Mask = NDArray[np.bool_]


def project(part: Part, transform: NDArray[np.float32]) -> NDArray[np.float32]:
    """(V, 2) pixel positions of a part's vertices under one (3, 4) transform.

    In float32 with the kernels' order of operations, so that twin and kernel decide about the same outline.
    """
    t = np.asarray(transform, dtype=np.float32)
    x, y, z = np.asarray(part.vertices, dtype=np.float32).T
    return np.stack([((x * row[0] + y * row[1]) + z * row[2]) + row[3] for row in t[:2]], axis=1)


def silhouette_mask(mesh: Mesh, transforms: NDArray[np.float32], shape: tuple[int, int]) -> Mask:
    """(H, W) True where a pixel's centre is covered by any face, of any orientation, of any part.

    ``transforms`` is (P, 3, 4), body point at rest -> (x px, y px, depth). A centre exactly on an edge belongs
    to the face on its right, or below it for a level edge: neighbours share no pixel and leave none out.
    """
    mask = np.zeros(shape, dtype=bool)
    for part, transform in zip(mesh.parts, transforms, strict=True):
        corners = project(part, transform).astype(np.float64)
        for triangle in corners[part.faces]:
            _fill_triangle(mask, triangle)
    return mask


def _fill_triangle(mask: Mask, triangle: NDArray[np.float64]) -> None:
    """Cover the pixels whose centre is left of a face's right edges and not left of its left edges, row by row."""
    height, width = mask.shape
    y = triangle[:, 1]
    top, bottom = max(0, int(np.ceil(y.min() - 0.5))), min(height, int(np.ceil(y.max() - 0.5)))
    if top >= bottom:
        return
    centres = np.arange(top, bottom) + 0.5
    left = np.full(len(centres), np.inf)
    right = np.full(len(centres), -np.inf)
    for a, b in ((0, 1), (1, 2), (2, 0)):
        upper, lower = (triangle[a], triangle[b]) if y[a] <= y[b] else (triangle[b], triangle[a])
        crossed = (centres >= upper[1]) & (centres < lower[1])
        if not crossed.any():
            continue
        x = upper[0] + (centres[crossed] - upper[1]) * ((lower[0] - upper[0]) / (lower[1] - upper[1]))
        left[crossed] = np.minimum(left[crossed], x)
        right[crossed] = np.maximum(right[crossed], x)
    columns = np.arange(width) + 0.5
    mask[top:bottom] |= (columns >= left[:, None]) & (columns < right[:, None])


def reference_scores(
    mesh: Mesh, part_transforms: NDArray[np.float32], maps: NDArray[np.float32]
) -> NDArray[np.float64]:
    """(N, P, 3, 4) transforms and (K, H, W) maps -> (N, K) sums of each map under each silhouette."""
    values = np.asarray(maps, dtype=np.float64)
    scores = np.empty((len(part_transforms), len(values)))
    for n, transforms in enumerate(part_transforms):
        mask = silhouette_mask(mesh, transforms, (values.shape[1], values.shape[2]))
        scores[n] = values[:, mask].sum(axis=1)
    return scores

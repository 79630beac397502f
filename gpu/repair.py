"""Repairs that leave the silhouette as it is: identical vertices merged, degenerate and duplicate faces dropped."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class RepairCounts:
    """What was dropped from one part."""

    merged_vertices: int
    degenerate_faces: int
    duplicate_faces: int


def repair(
    vertices: NDArray[np.float64], faces: NDArray[np.int64]
) -> tuple[NDArray[np.float64], NDArray[np.int32], RepairCounts]:
    """(V, 3), (F, 3) -> the vertices in use (identical ones merged), the faces with an area, each once."""
    used, flat = np.unique(faces, return_inverse=True)
    vertices, faces = vertices[used] + 0.0, flat.reshape(-1, 3)  # + 0.0: -0.0 and 0.0 are one coordinate
    unique, inverse = np.unique(vertices, axis=0, return_inverse=True)
    faces = inverse.reshape(-1)[faces]
    solid = faces[_has_area(unique, faces)]
    _, first = np.unique(np.sort(solid, axis=1), axis=0, return_index=True)
    kept = solid[np.sort(first)]
    still_used, flat = np.unique(kept, return_inverse=True)
    counts = RepairCounts(len(vertices) - len(unique), len(faces) - len(solid), len(solid) - len(kept))
    return unique[still_used], flat.reshape(-1, 3).astype(np.int32), counts


def _has_area(vertices: NDArray[np.float64], faces: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Faces whose height is above rounding: below it no view shows them, and their normal is noise."""
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    doubled = np.linalg.norm(np.cross(b - a, c - a), axis=1)
    longest = np.max([np.linalg.norm(e, axis=1) for e in (b - a, c - b, a - c)], axis=0)
    extent = float(np.ptp(vertices, axis=0).max()) if len(vertices) else 0.0
    return np.asarray(doubled > 1e-9 * extent * longest)


def is_watertight(faces: NDArray[np.int32]) -> bool:
    """Whether every edge has exactly two faces, which run along it in opposite directions."""
    forward = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]).astype(np.int64)
    if len(forward) == 0:
        return False
    n = int(faces.max()) + 1
    keys, counts = np.unique(forward[:, 0] * n + forward[:, 1], return_counts=True)
    reverse = np.unique(forward[:, 1] * n + forward[:, 0])
    return bool((counts == 1).all() and np.array_equal(keys, reverse))


def describe_repair(name: str, counts: RepairCounts) -> list[str]:
    """Warnings for people; merging vertices is not worth one."""
    found = []
    if counts.degenerate_faces:
        found.append(f"part {name!r}: {counts.degenerate_faces} faces without area dropped")
    if counts.duplicate_faces:
        found.append(f"part {name!r}: {counts.duplicate_faces} duplicate faces dropped")
    return found

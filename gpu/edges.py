"""From triangles to outline edges: each edge with the two face normals that decide whether it is outline.

Count every face with positive projected area. A row then enters the face by one of its edges (+1) and leaves it by
another (-1), and a pixel is covered where the sum of what lies to its left, the winding, is not zero. An edge from
vertex a to b between face A, which runs along it forward, and face B, which runs backward, contributes
``sign(A) - sign(B)``, where the sign is that of the face's normal along the viewing direction: nothing, unless one
faces the camera and the other does not. So only the outline of a closed mesh is ever drawn, and any mesh is exact:

- two faces that run along an edge the same way: B's normal is negated,
- a border (one face): B's normal is zero,
- more than two faces: several records with the same vertices,
- two faces in one plane: never outline, dropped here.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

NORMAL_DIGITS = 1e-6  # unit normals closer than this are one plane


@dataclass(frozen=True)
class Edges:
    """Outline edges of one part."""

    ends: NDArray[np.int32]  # (E, 2) vertex indices a, b
    normal_a: NDArray[np.float32]  # (E, 3) unit normal of the face that runs a -> b, or zero
    normal_b: NDArray[np.float32]  # (E, 3) of the face that runs b -> a, or zero

    def __len__(self) -> int:
        return len(self.ends)


def outline_edges(vertices: NDArray[np.float64], faces: NDArray[np.int32]) -> Edges:
    """All edges of (V, 3), (F, 3) that are outline from some direction."""
    normals = unit_normals(vertices, faces)
    starts = faces.ravel().astype(np.int64)
    stops = np.roll(faces, -1, axis=1).ravel().astype(np.int64)
    face = np.repeat(np.arange(len(faces)), 3)
    forward = starts < stops
    key = np.where(forward, starts * len(vertices) + stops, stops * len(vertices) + starts)
    order = np.lexsort((~forward, key))  # forward users of an edge first
    key, forward, face = key[order], forward[order], face[order]
    _, first, count = np.unique(key, return_index=True, return_counts=True)
    ends, a, b = _pairs(first, count, forward, normals[face])
    a, b = a.astype(np.float32), b.astype(np.float32)
    flat = (a == b).all(axis=1)  # the very same: else their signs could differ, and a row would not close
    keys = key[ends[~flat]]
    return Edges(
        np.stack([keys // len(vertices), keys % len(vertices)], axis=1).astype(np.int32),
        a[~flat],
        b[~flat],
    )


def _pairs(
    first: NDArray[np.int64],
    count: NDArray[np.int64],
    forward: NDArray[np.bool_],
    normals: NDArray[np.float64],
) -> tuple[NDArray[np.int64], NDArray[np.float64], NDArray[np.float64]]:
    """Pair the faces of each edge: first with last, second with last but one; the odd one out with none.

    Forward faces come first, so consistent neighbours meet. Returns each pair's position in the sorted list, and
    the normals a, b such that the pair contributes ``sign(a) - sign(b)``.
    """
    signed = np.where(forward[:, None], normals, -normals)  # each use contributes the sign of this
    where, a, b = [], [], []
    for k in range(int(count.max(initial=0) + 1) // 2):
        left, right = first + k, first + count - 1 - k
        paired = right > left
        where.append(left[paired])
        a.append(signed[left[paired]])
        b.append(-signed[right[paired]])
        single = right == left
        where.append(left[single])
        a.append(signed[left[single]])
        b.append(np.zeros((int(single.sum()), 3)))
    if not where:
        return np.zeros(0, np.int64), np.zeros((0, 3)), np.zeros((0, 3))
    return np.concatenate(where), np.concatenate(a), np.concatenate(b)


def unit_normals(vertices: NDArray[np.float64], faces: NDArray[np.int32]) -> NDArray[np.float64]:
    """(F, 3) unit normals; faces in one plane get the very same numbers."""
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    normal = np.cross(b - a, c - a)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    _, first, inverse = np.unique(
        np.round(normal / NORMAL_DIGITS).astype(np.int64), axis=0, return_index=True, return_inverse=True
    )
    return np.asarray(normal[first][inverse.reshape(-1)], dtype=np.float64)

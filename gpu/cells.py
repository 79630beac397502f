"""The sphere of viewing directions cut into cells, so that a particle looks only at edges that it can see as outline.

An edge's contribution depends on the view only through signs of ``normal . direction``, which is linear: over a
cell that is flat in suitable coordinates (a square on a face of a cube), a sign that is the same at the four corners
is the same all over the cell. Opposite directions see the same edges, so three faces of the cube are enough.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gpu.edges import Edges

AXES = ((0, 1, 2), (1, 2, 0), (2, 0, 1))  # per cube face: the major axis, then the axes of u and v
DOUBT = 1e-5  # a cosine this small may have either sign in float32


def cell_count(across: int) -> int:
    """Cells with ``across`` squares along each side of a cube face."""
    return 3 * across * across


def cell_corners(across: int) -> NDArray[np.float64]:
    """(3, across + 1, across + 1, 3) unit directions of the cells' corners: cube face, v, u."""
    grid = np.linspace(-1.0, 1.0, across + 1)
    v, u = np.meshgrid(grid, grid, indexing="ij")
    corners = np.empty((3, across + 1, across + 1, 3))
    for face, (major, along_u, along_v) in enumerate(AXES):
        corners[face, ..., major] = 1.0
        corners[face, ..., along_u] = u
        corners[face, ..., along_v] = v
    return np.asarray(corners / np.linalg.norm(corners, axis=-1, keepdims=True))


def possible_outline(edges: Edges, across: int) -> NDArray[np.bool_]:
    """(cells, E) True where an edge is outline from some direction of a cell."""
    normals, which = np.unique(np.vstack([edges.normal_a, edges.normal_b]), axis=0, return_inverse=True)
    sign = _cell_signs(normals, across)[:, which.reshape(-1)]
    a, b = sign[:, : len(edges)], sign[:, len(edges) :]
    border = ~edges.normal_a.any(axis=1) | ~edges.normal_b.any(axis=1)
    return np.asarray((a != b) | (a == 0) | border)


def _cell_signs(normals: NDArray[np.float32], across: int) -> NDArray[np.int8]:
    """(cells, U) sign of ``normal . direction`` all over each cell; 0 where it changes or is in doubt."""
    cosine = np.tensordot(cell_corners(across), normals.astype(np.float64), axes=(3, 1))  # (3, A + 1, A + 1, U)
    sign = (cosine > DOUBT).astype(np.int8) - (cosine < -DOUBT).astype(np.int8)
    total = sign[:, :-1, :-1] + sign[:, 1:, :-1] + sign[:, :-1, 1:] + sign[:, 1:, 1:]
    return np.asarray((total == 4).astype(np.int8) - (total == -4).astype(np.int8)).reshape(cell_count(across), -1)

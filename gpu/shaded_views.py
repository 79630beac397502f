"""Views from all around, in which a face that no view shows is taken to be hidden inside its part."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from gpu.mesh import Mesh

VIEWS = 128  # of each part
SIDE = 192  # samples across a part
_GOLDEN = np.pi * (3.0 - 5.0**0.5)


def views_of_parts(mesh: Mesh) -> NDArray[np.float32]:
    """(P * VIEWS, P, 3, 4) transforms: each part alone in ``SIDE`` pixels, the others shrunk to nothing."""
    n_parts = len(mesh.parts)
    out = np.zeros((n_parts, VIEWS, n_parts, 3, 4), np.float32)
    turns = _directions()
    for number, part in enumerate(mesh.parts):
        low, high = part.vertices.min(axis=0), part.vertices.max(axis=0)
        middle = 0.5 * (low + high)
        radius = float(np.linalg.norm(part.vertices - middle, axis=1).max())
        placed = (0.5 * SIDE / max(radius, 1e-300)) * turns
        out[number, :, number, :, :3] = placed
        out[number, :, number, :, 3] = np.array([0.5 * SIDE, 0.5 * SIDE, 0.0]) - placed @ middle
    return out.reshape(n_parts * VIEWS, n_parts, 3, 4)


def _directions() -> NDArray[np.float64]:
    """(VIEWS, 3, 3) rotations whose lines of sight are spread evenly over the sphere."""
    k = np.arange(VIEWS)
    tilt = np.arccos(1.0 - 2.0 * (k + 0.5) / VIEWS)
    return np.asarray(Rotation.from_euler("zyz", np.column_stack([k * _GOLDEN, tilt, k * 1.0])).as_matrix())

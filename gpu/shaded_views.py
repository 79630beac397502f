"""Views from all around, in which a face that no view shows is taken to be hidden inside its part."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from gpu.mesh import Part

VIEWS = 128  # of each part
SIDE = 192  # samples across a part
_GOLDEN = np.pi * (3.0 - 5.0**0.5)


def views_of_part(part: Part) -> NDArray[np.float32]:
    """(VIEWS, 1, 3, 4) transforms: the part in ``SIDE`` pixels."""
    low, high = part.vertices.min(axis=0), part.vertices.max(axis=0)
    middle = 0.5 * (low + high)
    radius = float(np.linalg.norm(part.vertices - middle, axis=1).max())
    placed = (0.5 * SIDE / max(radius, 1e-300)) * _directions()
    out = np.empty((VIEWS, 1, 3, 4), np.float32)
    out[:, 0, :, :3] = placed
    out[:, 0, :, 3] = np.array([0.5 * SIDE, 0.5 * SIDE, 0.0]) - placed @ middle
    return out


def _directions() -> NDArray[np.float64]:
    """(VIEWS, 3, 3) rotations whose lines of sight are spread evenly over the sphere."""
    k = np.arange(VIEWS)
    tilt = np.arccos(1.0 - 2.0 * (k + 0.5) / VIEWS)
    return np.asarray(Rotation.from_euler("zyz", np.column_stack([k * _GOLDEN, tilt, k * 1.0])).as_matrix())

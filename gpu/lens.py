"""A pinhole camera before bodies that were scaled as if they were far away.

A body's point has come to (x, y, z) px, its depth z counted from the body's centre: weak perspective would show it at
(x, y). Through a lens of focal length f and principal point (a, b) it is seen at (a, b) + (x - a, y - b) / (1 + z / f):
the centre is f away where a pixel is as large as at the centre. z / (1 + z / f) is as flat over the image as the body's
faces are, so it stands for the depth.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Lens = tuple[float, float, float]  # focal length, principal point; px
NO_LENS: Lens = (float("inf"), 0.0, 0.0)
NEAREST = 0.05  # of the distance to the body's centre: nothing is drawn as if it were nearer


def seen_through(points: NDArray[np.floating], lens: Lens) -> Floats:
    """(..., 3) points as they are seen: x, y, and what stands for the depth."""
    focal, *middle = lens
    out = np.array(points, dtype=np.float64)
    nearer = 1.0 / np.maximum(1.0 + out[..., 2:] / focal, NEAREST)
    out[..., :2] = middle + (out[..., :2] - middle) * nearer
    out[..., 2:] *= nearer
    return out


def where_seen(points: NDArray[np.floating], lens: Lens) -> Floats:
    """What ``seen_through`` shows at (..., 3) points."""
    focal, *middle = lens
    out = np.array(points, dtype=np.float64)
    farther = 1.0 / (1.0 - out[..., 2:] / focal)
    out[..., :2] = middle + (out[..., :2] - middle) * farther
    out[..., 2:] *= farther
    return out


def magnified(lens: Lens, by: float) -> Lens:
    """The same camera with ``by`` times as many pixels along each side."""
    return by * lens[0], by * lens[1], by * lens[2]

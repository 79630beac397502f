"""Which pixels a body covers, in many views at once: NumPy without depth, milliseconds for thousands of faces."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

_MOST_AT_ONCE = 1 << 19  # faces times views


def silhouettes(vertices: NDArray[np.floating], faces: NDArray[np.integer], side: int) -> NDArray[np.bool_]:
    """(N, V, 2 or 3) vertices in pixels, (F, 3) faces -> (N, side, side): is a pixel's centre covered?"""
    n = len(vertices)
    covered = np.zeros((n, side, side), dtype=bool)
    step = max(1, _MOST_AT_ONCE // max(len(faces), 1))
    for first in range(0, n, step):
        covered[first : first + step] = _covered(vertices[first : first + step], faces, side)
    return covered


def _covered(vertices: NDArray[np.floating], faces: NDArray[np.integer], side: int) -> NDArray[np.bool_]:
    """Runs of pixels, each +1 where it begins and -1 where it ends, summed along the rows."""
    n = len(vertices)
    x, y = (vertices[..., k].astype(np.float32) - np.float32(0.5) for k in (0, 1))  # centres at whole numbers
    column, row = (np.clip(np.ceil(v), 0, side).astype(np.int16) for v in (x, y))
    a, b, c = faces.T

    def crosses(cell: NDArray[np.int16]) -> NDArray[np.bool_]:
        p, q, r = cell[:, a], cell[:, b], cell[:, c]
        return np.asarray((p != q) | (q != r))

    view, face = np.nonzero(crosses(column) & crosses(row))
    corners = faces[face].T
    px, py = x[view, corners], y[view, corners]  # (3, M)
    rows = row[view, corners]
    top = rows.min(axis=0).astype(np.int64)
    height = rows.max(axis=0).astype(np.int64) - top
    owner = np.repeat(np.arange(len(face)), height)
    line = np.arange(len(owner)) - np.repeat(np.cumsum(height) - height, height) + top[owner]
    left, right = np.full(len(owner), np.inf, np.float32), np.full(len(owner), -np.inf, np.float32)
    for k in range(3):
        m = (k + 1) % 3
        rise = py[m] - py[k]
        slope = (px[m] - px[k]) / np.where(rise == 0, np.float32(1.0), rise)
        start, end = py[k][owner], py[m][owner]
        at = px[k][owner] + (line - start) * slope[owner]
        crossed = (start < line) != (end < line)
        left = np.where(crossed & (at < left), at, left)
        right = np.where(crossed & (at > right), at, right)
    first, last = (np.clip(np.ceil(v), 0, side).astype(np.int64) for v in (left, right))
    some = last > first
    cell = (view[owner] * side + line)[some] * (side + 1)
    size = n * side * (side + 1)
    change = np.bincount(cell + first[some], minlength=size) - np.bincount(cell + last[some], minlength=size)
    return np.asarray(np.cumsum(change.reshape(n, side, side + 1), axis=2)[:, :, :side] > 0)

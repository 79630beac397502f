"""A z-buffer in NumPy: which triangle each pixel sees, and how deep.

Triangles are cut into one span per pixel row, spans into fragments, and the fragments meet in one array of
(depth, triangle) keys. All of it is array work: 20,000 triangles take tens of milliseconds.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
_DEPTH_STEPS = float(1 << 30)
_EMPTY = np.iinfo(np.int64).max


@dataclass(frozen=True)
class Visible:
    """What a view shows. Both arrays are (H, W); where nothing is seen, -1 and +inf."""

    face: NDArray[np.int64]
    depth: Floats


@dataclass(frozen=True)
class _Spans:
    """Runs of pixels in one row: triangle, row, first column, length; (S,) each."""

    triangle: NDArray[np.int64]
    row: NDArray[np.int64]
    first: NDArray[np.int64]
    length: NDArray[np.int64]


def rasterise(corners: Floats, width: int, height: int) -> Visible:
    """The nearest of F triangles at every pixel centre.

    ``corners`` is (F, 3, 3): x and y in pixels (outer corner of the first pixel at 0, 0), z the depth,
    smaller is nearer. Both sides of a triangle are seen.
    """
    face = np.full(width * height, -1, dtype=np.int64)
    depth = np.full(width * height, np.inf)
    spans = _spans(corners, width, height)
    if len(spans.row):
        pixel, triangle, z = _fragments(corners, spans, width)
        near, far = float(z.min()), float(z.max())
        steps = ((z - near) * (_DEPTH_STEPS / max(far - near, 1e-12))).astype(np.int64)
        keys = np.full(width * height, _EMPTY, dtype=np.int64)
        np.minimum.at(keys, pixel, (steps << 32) | triangle)
        hit = keys != _EMPTY
        face[hit] = keys[hit] & 0xFFFFFFFF
        depth[hit] = (keys[hit] >> 32) * ((far - near) / _DEPTH_STEPS) + near
    return Visible(face.reshape(height, width), depth.reshape(height, width))


def _spans(corners: Floats, width: int, height: int) -> _Spans:
    """Rows whose centre line crosses a triangle, and the pixel centres between the crossings."""
    y = corners[:, :, 1]
    top = np.clip(np.ceil(y.min(axis=1) - 0.5), 0, height).astype(np.int64)
    rows = np.clip(np.ceil(y.max(axis=1) - 0.5), 0, height).astype(np.int64) - top
    triangle = np.repeat(np.arange(len(corners)), rows)
    row = np.arange(rows.sum()) - np.repeat(np.cumsum(rows) - rows, rows) + top[triangle]
    left = np.full(len(row), np.inf)
    right = np.full(len(row), -np.inf)
    for a, b in ((0, 1), (1, 2), (2, 0)):
        start, end = corners[triangle, a, :2], corners[triangle, b, :2]
        rise = end[:, 1] - start[:, 1]
        share = (row + 0.5 - start[:, 1]) / np.where(rise == 0, 1.0, rise)
        x = start[:, 0] + share * (end[:, 0] - start[:, 0])
        crossed = (start[:, 1] <= row + 0.5) != (end[:, 1] <= row + 0.5)
        left = np.where(crossed, np.minimum(left, x), left)
        right = np.where(crossed, np.maximum(right, x), right)
    seen = right > left
    triangle, row, left, right = triangle[seen], row[seen], left[seen], right[seen]
    first = np.clip(np.ceil(left - 0.5), 0, width).astype(np.int64)
    length = np.clip(np.ceil(right - 0.5), 0, width).astype(np.int64) - first
    some = length > 0
    return _Spans(triangle[some], row[some], first[some], length[some])


def _fragments(corners: Floats, spans: _Spans, width: int) -> tuple[NDArray[np.int64], NDArray[np.int64], Floats]:
    """Pixel index, triangle and depth of every covered pixel of every triangle."""
    edge_1, edge_2 = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    normal = np.cross(edge_1, edge_2)
    slope = -normal[:, :2] / np.where(normal[:, 2:] == 0, 1.0, normal[:, 2:])
    anchor = corners[spans.triangle, 0]
    x, y = spans.first + 0.5 - anchor[:, 0], spans.row + 0.5 - anchor[:, 1]
    z_first = anchor[:, 2] + slope[spans.triangle, 0] * x + slope[spans.triangle, 1] * y
    owner = np.repeat(np.arange(len(spans.row)), spans.length)
    along = np.arange(len(owner)) - np.repeat(np.cumsum(spans.length) - spans.length, spans.length)
    triangle = spans.triangle[owner]
    depth = z_first[owner] + slope[triangle, 0] * along
    # A triangle seen edge-on has a steep plane: rounding must not carry its depth past its own corners.
    low, high = corners[:, :, 2].min(axis=1), corners[:, :, 2].max(axis=1)
    depth = np.clip(depth, low[triangle], high[triangle])
    return (spans.row * width + spans.first)[owner] + along, triangle, depth

"""Row prefix sums of a map in fixed point, so that a sum has the same bits in any order and on any device."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


def fixed_point_prefix(maps: NDArray[np.float32]) -> tuple[NDArray[np.int32], NDArray[np.float64]]:
    """(K, H, W) maps -> (K, H, W + 1) int32 prefix sums and (K,) value of one unit (a power of two).

    The unit is the smallest for which no prefix overflows, whatever the map: rounding a pixel to it costs at most
    W 2^-32 of the largest value. Raises ``ValueError`` for a map with a value that is not finite.
    """
    values = np.asarray(maps, dtype=np.float64)
    largest = np.abs(values).max(axis=(1, 2), initial=0.0)
    if not np.isfinite(largest).all():
        raise ValueError("the map has a value that is not finite")
    width = values.shape[2]
    exponent = np.ceil(np.log2(np.maximum(largest, 1e-300) * width)) - 30
    unit = np.exp2(np.maximum(exponent, -1000))
    prefix = np.zeros((*values.shape[:2], width + 1), np.int32)
    np.cumsum(np.rint(values / unit[:, None, None]), axis=2, out=values)
    prefix[:, :, 1:] = values
    return prefix, unit

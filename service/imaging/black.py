"""The noise of a sky whose black point was raised: of which only the upper tail is left."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtri

# prior: a sky of which more lies above its least count is whole; of one that has less nothing is told; where so
# many pixels are at the least stars are told from noise; share of what lies above by which the tail's width is told
_WHOLE, _LEAST, _SPARSE, _PART = 0.95, 0.003, 0.2, 0.3
_AROUND = np.array([[1, 1, 1], [1, 0, 1], [1, 1, 1]], np.uint8)  # exact: a pixel's neighbours


def sigma_behind_black(frames: NDArray[np.int64], known: NDArray[np.bool_]) -> NDArray[np.float64]:
    """(C,) noise of a normal law that was cut off at the least of (K, H, W, C) whole numbers; 0 where none was.

    ``known`` (H, W): pixels that show sky. Programs that make a sky black leave nothing of most of its pixels, but what
    lies above has all of the noise. With P_k the share of pixels that are k counts or more above the least, z_k its
    normal quantile: sigma = (k - 1) / (z_1 - z_k). Where few are above, only those count whose neighbours are not:
    stars' pixels are never alone, and of noise they are as all are. A channel of which nothing is left is as loud as
    the loudest.
    """
    out, nothing_left = np.zeros(frames.shape[3]), np.zeros(frames.shape[3], np.bool_)
    for channel in range(len(out)):
        values = frames[..., channel]
        counted = np.broadcast_to(known, values.shape)
        least = int(values[counted].min())
        above = (values > least).astype(np.uint8)
        share = above[counted].mean()
        if share > _WHOLE:
            continue
        if share < _SPARSE:
            counted = counted & np.stack([cv2.dilate(one, _AROUND) == 0 for one in above])
        count = np.count_nonzero(counted)
        if not count:
            continue
        tail = (
            count - np.cumsum(np.bincount(values[counted] - least))
        ) / count  # of 1, 2, ... and more above the least
        nothing_left[channel] = tail[0] < _LEAST
        k = max(int(np.argmin(np.abs(tail - _PART * tail[0]))), 1)
        if not nothing_left[channel] and tail[k] > 0:
            out[channel] = k / float(ndtri(1 - tail[k]) - ndtri(1 - tail[0]))
    out[nothing_left] = out.max()
    return out

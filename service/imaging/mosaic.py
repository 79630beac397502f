"""Raw frames of a colour sensor, whose pixels lie behind red, green and blue filters in squares of two by two."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

_TAPS = np.array([0.25, 0.5, 0.25], np.float32)  # exact: nothing of what changes from one pixel to the next is left


def without_mosaic(image: NDArray[Any]) -> NDArray[np.float32]:
    """(H, W) the mean of the filters about each pixel, in whichever order they lie. Counts of 8 and 16 bits become
    shares of full scale, for means are finer than they are.
    """
    whole = image.dtype.kind == "u" and image.dtype.itemsize <= 2
    share = image.astype(np.float32) / (np.iinfo(image.dtype).max if whole else 1)
    return np.asarray(cv2.sepFilter2D(share, cv2.CV_32F, _TAPS, _TAPS, borderType=cv2.BORDER_REFLECT_101), np.float32)

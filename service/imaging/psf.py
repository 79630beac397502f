"""The width of the point spread, from the sharpest edges of the object against the sky."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

# numerical: all of them, of a first guess of the point spread's width
_PRESMOOTH_PX = 0.6
_PIXEL_VARIANCE = 0.5  # of the pixel's own box and of the derivative kernel, px^2
_REACHES_PX = (4, 8, 16)
_FEWEST_EDGES, _CREST_PX = 8, 5
_STEP, _FOOT = 12, 4  # sigmas of the sky: least height of an edge, most light at its foot
_HOLDS = 0.45  # of a reach: the widest point spread that it shows whole
_SHARPER, _LEAST_VARIANCE = 25, 0.1  # per cent of edges that are believed; px^2


def estimate_psf_sigma(contrast: NDArray[np.float32]) -> float | None:
    """Gaussian sigma (px) of the point spread, or None where the frame shows too few clear edges.

    ``contrast`` (H, W) is the absolute brightness above the sky in units of its noise. A step of height h blurred
    by sigma has slope h / (sqrt(2 pi) sigma); edges within the object are shading, not steps, so only those that
    fall to the sky count, and of these the sharper quarter. The height is seen in a window that must hold the whole
    step: the smallest one that is wide enough for what it finds is believed.
    """
    z = np.asarray(cv2.GaussianBlur(contrast, (0, 0), _PRESMOOTH_PX), dtype=np.float32)
    dx = cv2.Sobel(z, cv2.CV_32F, 1, 0, ksize=3, scale=0.125)
    dy = cv2.Sobel(z, cv2.CV_32F, 0, 1, ksize=3, scale=0.125)
    slope = np.asarray(np.hypot(dx, dy), dtype=np.float32)
    crest = (slope >= cv2.dilate(slope, np.ones((_CREST_PX, _CREST_PX), dtype=np.uint8))) & (slope > 1)
    if np.count_nonzero(crest) < _FEWEST_EDGES:
        return None
    sigma = None
    for reach in _REACHES_PX:
        sigma = _sigma_within(z, slope, crest, reach) or sigma
        if sigma is not None and sigma <= _HOLDS * reach:
            break
    return sigma


def _sigma_within(
    z: NDArray[np.float32], slope: NDArray[np.float32], crest: NDArray[np.bool_], reach: int
) -> float | None:
    """Sigma from the steps seen within ``reach`` px of their crest; None for too few of them."""
    window = np.ones((2 * reach + 1, 2 * reach + 1), dtype=np.uint8)
    low = cv2.erode(z, window)
    height = cv2.dilate(z, window) - low
    edges = crest & (height > _STEP) & (low < _FOOT)
    if np.count_nonzero(edges) < _FEWEST_EDGES:
        return None
    width = height[edges] / (np.sqrt(2 * np.pi) * slope[edges])
    variance = float(np.percentile(width, _SHARPER)) ** 2 - _PRESMOOTH_PX**2 - _PIXEL_VARIANCE
    return float(np.sqrt(max(variance, _LEAST_VARIANCE)))

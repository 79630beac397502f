"""From a frame to a measurement: the map log c (Eq. 3) and the constant of Eq. 2, as published.

log c = log p(D|f) - log p(D|b) per pixel, with p(D|b) an empirical histogram of the sky's feature and p(D|f) uniform
over the feature's range.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from service.imaging.features import feature_bins
from service.imaging.sky import Sky


def measure(image: NDArray[np.generic], sky: Sky) -> tuple[NDArray[np.float32], float]:
    """A frame (H, W) or (H, W, C) against the sky: (H, W) log c, and the sum over it of log p(D|b) - log p(D)."""
    bins = feature_bins(image, sky.spec)
    counts = np.bincount(bins.ravel(), minlength=sky.spec.n_bins)
    some = np.flatnonzero(counts)
    constant = float(counts[some] @ (sky.log_density[some] - np.log(counts[some] / counts.sum())))
    return np.asarray(-np.log(sky.spec.n_bins) - sky.log_density[bins], dtype=np.float32), constant

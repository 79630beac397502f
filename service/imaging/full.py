"""Where a sensor is full: at the file's upper end, or below it, where counts pile up."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.special import gammaln

_LOWER = 0.1  # prior: probability that a sensor is full below what its file holds, and that a frame shows it
_SURE = 0.9  # numerical: probability from which on this is told
_BRIGHT_SIGMAS = 6.0  # prior: of the empty sky's noise: a sensor that is full is full of light
_SAMPLE = 4_096  # numerical: bright pixels that tell by which steps their counts go
_NEAR_SIGMAS = 3.0  # numerical: of that noise: pixels so far below the brightest one tell of it


def upper_end(
    data: NDArray[np.float32], mean: NDArray[np.float32], sigma: NDArray[np.float64], step: int, most: int
) -> NDArray[np.float32]:
    """(C,) counts from which on a pixel of a frame (H, W, C) says "at least so much".

    Light has noise, and a full pixel has none. ``mean`` (H, W, C) and ``sigma`` (C,) of the empty sky; counts go by
    ``step``, and end at ``most``.
    """
    each = zip(np.moveaxis(data, 2, 0), np.moveaxis(mean, 2, 0), sigma, strict=True)
    return np.array([_end(*one, step, most) for one in each], np.float32)


def _end(data: NDArray[np.float32], mean: NDArray[np.float32], sigma: np.float64, step: int, most: int) -> float:
    """Of one channel. Of the N pixels that are near the brightest one n are as bright. One count of k has no more than
    a k-th of them, by chance, where light is noisy; any share of them where the sensor is full there.
    """
    at = int(np.argmax(data))
    brightest = float(data.flat[at])
    if brightest >= most or brightest - mean.flat[at] < _BRIGHT_SIGMAS * sigma:
        return float(most)
    near = int(np.count_nonzero(data >= brightest - _NEAR_SIGMAS * sigma)) - 1  # beside the brightest itself
    alike = int(np.count_nonzero(data == brightest)) - 1
    counts = 1 + np.floor(_NEAR_SIGMAS * sigma / max(step, _step_of(data[data > 0.5 * (brightest + mean.flat[at])])))
    if alike < near / counts or counts == 1:
        return float(most)
    choices = gammaln(near + 1) - gammaln(alike + 1) - gammaln(near - alike + 1)
    by_chance = choices + alike * np.log(1 / counts) + (near - alike) * np.log1p(-1 / counts)
    log_odds = np.log(_LOWER / (1 - _LOWER)) - np.log(near + 1) - by_chance
    return brightest if log_odds > np.log(_SURE / (1 - _SURE)) else float(most)


def _step_of(bright: NDArray[np.float32]) -> float:
    """By how much bright pixels (N,) differ at the least: counts that were stretched lie far apart there."""
    values = np.unique(bright[:: max(1, len(bright) // _SAMPLE)])
    return float(np.diff(values).min()) if len(values) > 1 else np.inf

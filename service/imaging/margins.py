"""Where a frame shows nothing: black bars, the borders of a stabilised video, what lies outside of an eyepiece."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

Mask = NDArray[np.bool_]

_BLACK = 3 / 255  # prior: of full scale, at the most: compression leaves no more in what was black
_FLAT_PX, _SMEARED_PX = 5, 2  # prior: px across: of what is no noise; by which an edge is smeared
# prior: least share of an image that shows something, most of that which may be as dark as what does not
_SHOWN, _AS_DARK = 0.2, 0.01
# prior: what lies beside is brighter by so many times what an empty sky differs by; by so many counts, where it is
# not known to be empty
_BRIGHTER_SIGMAS, _BRIGHTER = 3.0, 4.0
_DIM = 0.9  # prior: share of an empty sky without its stars
_ABOVE_SIGMAS = 3.0  # prior: the learnt sky over a pixel's least count


def margins_of(image: NDArray[Any], *, empty: bool) -> Mask | None:
    """(H, W) of a frame (H, W, C) that was not yet compared with a sky; None: there are none.

    They are black, at the least count of the image's edge, from there on, and what lies between is not as dark: of a
    black sky much is. ``empty``: the sky alone is seen; else the object may fill the image, and a black sky about it is
    no margin.
    """
    least = _edge(image).min(axis=0)
    if least.max() > _BLACK * np.iinfo(image.dtype).max:
        return None
    dark = (image <= least).all(axis=2)
    found = _flat(dark)
    if found is None:
        return None
    shown = ~found
    if shown.mean() < _SHOWN or dark[shown].mean() > _AS_DARK:
        return None
    above = (image.astype(np.float32) - least.astype(np.float32)).mean(axis=2)
    beside = cv2.dilate(found.astype(np.uint8), _square(3)).astype(bool) & shown
    enough = _BRIGHTER
    if empty:
        sky = np.minimum(above[shown], np.quantile(above[shown], _DIM))
        enough = max(_BRIGHTER_SIGMAS * float(sky.std()), 1.0)
    return found if np.median(above[beside]) >= enough else None


def margins_under(image: NDArray[np.generic], mean: NDArray[np.float32], sigma: NDArray[np.float64]) -> Mask | None:
    """(H, W) of a frame (H, W, C) whose learnt sky (H, W, C) is brighter there by more than its noise (C,)."""
    edge = _edge(image)
    least = edge.min(axis=0).astype(np.float32)
    too_dark = least + np.asarray(_ABOVE_SIGMAS * sigma, np.float32)
    dark = ((edge <= least) & (_edge(mean) > too_dark)).all(axis=1)
    if not np.all([dark[k : len(dark) - _FLAT_PX + k] for k in range(_FLAT_PX)], axis=0).any():
        return None
    return _flat((image <= least).all(axis=2) & (mean > too_dark).all(axis=2))


def _edge(image: NDArray[Any]) -> NDArray[Any]:
    """(N, C) the pixels along the edge of (H, W, C)."""
    return np.concatenate([image[0], image[-1], image[:, 0], image[:, -1]])


def either(first: Mask | None, second: Mask | None) -> Mask | None:
    """Where either is; None: nowhere."""
    if first is None or second is None:
        return second if first is None else first
    return first | second


def _flat(least: Mask) -> Mask | None:
    """(H, W) wide places at the ``least`` count that reach the image's edge, with what their edges smear."""
    dark = np.pad(least.astype(np.uint8), _FLAT_PX, mode="edge")  # margins go on beyond the edge
    flat = cv2.morphologyEx(dark, cv2.MORPH_OPEN, _square(_FLAT_PX))[_FLAT_PX:-_FLAT_PX, _FLAT_PX:-_FLAT_PX]
    _, labels = cv2.connectedComponents(flat)
    reach = np.unique(np.concatenate([labels[0], labels[-1], labels[:, 0], labels[:, -1]]))
    reach = reach[reach > 0]
    if not len(reach):
        return None
    found = np.isin(labels, reach).astype(np.uint8)
    return np.asarray(cv2.dilate(found, _square(2 * _SMEARED_PX + 1)).astype(bool))


def _square(side: int) -> NDArray[np.uint8]:
    return np.ones((side, side), np.uint8)

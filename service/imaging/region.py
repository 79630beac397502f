"""Foreground and background learned from around the object, for scenes that are never empty.

Where no frame without the object exists, the background is learned outside of a given box and the foreground
inside of it, less the background's share; while a track is held both follow the frame: the foreground from inside
the best silhouette, the background from a ring around it. Both are histograms of colour or intensity.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

_GREY_LEVELS = 64
_COLOUR_LEVELS = 16  # per channel
_LEARN = 0.15  # share of the newest frame
_FLOOR = 0.01  # of a uniform distribution, mixed into both histograms
_SMOOTH_PX = 1.0
_LIMIT_NATS = 3.0

Histogram = NDArray[np.float32]


@dataclass(frozen=True)
class Region:
    """Distributions of the feature inside and around the object; each sums to 1."""

    foreground: Histogram
    background: Histogram


def region_levels(channels: int) -> int:
    """Levels per axis of the histograms of an image of 1 or 3 channels."""
    return _COLOUR_LEVELS if channels == 3 else _GREY_LEVELS


def region_bins(image: NDArray[np.generic], bits: int) -> tuple[NDArray[np.intp], int]:
    """(H, W) coarse bin per pixel and the number of levels per axis."""
    smooth = cv2.GaussianBlur(image.astype(np.float32), (0, 0), _SMOOTH_PX)
    levels = region_levels(image.shape[2] if image.ndim == 3 else 1)
    level = np.clip((smooth * (levels / 2.0**bits)).astype(np.intp), 0, levels - 1)
    if image.ndim == 2:
        return level, levels
    return level[..., 0] * levels**2 + level[..., 1] * levels + level[..., 2], levels


def _histogram(bins: NDArray[np.intp], where: NDArray[np.bool_], levels: int, colour: bool) -> Histogram:
    """Smoothed over neighbouring bins, with a floor."""
    shape = (levels,) * (3 if colour else 1)
    counts = np.bincount(bins[where], minlength=int(np.prod(shape))).reshape(shape).astype(np.float32)
    counts = ndimage.gaussian_filter(counts, 1.0, mode="nearest").ravel()
    total = float(counts.sum())
    density = counts / total if total > 0 else np.full(counts.size, 1.0 / counts.size)
    return np.asarray((1 - _FLOOR) * density + _FLOOR / counts.size, dtype=np.float32)


def first_region(image: NDArray[np.generic], bits: int, known: NDArray[np.bool_]) -> Region:
    """Background from the ``known`` pixels (H, W), foreground from the others."""
    bins, levels = region_bins(image, bits)
    colour = image.ndim == 3
    background = _histogram(bins, known, levels, colour)
    inside = _histogram(bins, ~known, levels, colour)
    # The box holds background too; what the background explains is taken out, up to half of the box.
    foreground = np.maximum(inside - 0.5 * background, 0.02 * inside)
    return Region(np.asarray(foreground / foreground.sum(), dtype=np.float32), background)


def region_log_ratio(image: NDArray[np.generic], bits: int, region: Region) -> NDArray[np.float32]:
    """(H, W) log p(D|f) - log p(D|b), bounded so that no pixel rules alone (Eq. 3)."""
    bins, _ = region_bins(image, bits)
    ratio = np.log(region.foreground) - np.log(region.background)
    return np.asarray(np.clip(ratio, -_LIMIT_NATS, _LIMIT_NATS)[bins], dtype=np.float32)


def learn_region(region: Region, image: NDArray[np.generic], bits: int, mask: NDArray[np.bool_]) -> Region:
    """Follow the frame: foreground from inside ``mask`` (H, W), background from the ring around it."""
    if np.count_nonzero(mask) < 16:
        return region
    bins, levels = region_bins(image, bits)
    colour = image.ndim == 3
    reach = int(np.clip(0.5 * np.sqrt(np.count_nonzero(mask)), 5, 100)) | 1
    element = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * reach + 1, 2 * reach + 1))
    core = cv2.erode(mask.astype(np.uint8), np.ones((3, 3), np.uint8)) > 0
    near = cv2.dilate(mask.astype(np.uint8), np.ones((5, 5), np.uint8)) > 0
    ring = (cv2.dilate(mask.astype(np.uint8), element) > 0) & ~near
    inside = _histogram(bins, core if core.any() else mask, levels, colour)
    outside = _histogram(bins, ring, levels, colour) if ring.any() else region.background
    return Region(
        (1 - _LEARN) * region.foreground + np.float32(_LEARN) * inside,
        (1 - _LEARN) * region.background + np.float32(_LEARN) * outside,
    )

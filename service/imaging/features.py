"""What is measured in a pixel: intensity, colour, or the derivative image; quantised for histograms."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

COLOUR_LEVELS = 32  # numerical: per channel of the joint RGB histogram
GRADIENT_LEVELS = 1024  # numerical: of its histogram


@dataclass(frozen=True)
class FeatureSpec:
    """A feature with everything that its histogram needs."""

    name: str  # "intensity", "colour", "gradient"
    n_bins: int
    bits: int
    sigma_px: float = 1.0


def feature_spec(name: str, channels: int, bits: int, gradient_sigma_px: float) -> FeatureSpec:
    """Resolve ``auto`` and size the histogram: one bin per grey level, 32^3 colours, 1024 gradient magnitudes."""
    if name == "auto":
        name = "colour" if channels == 3 else "intensity"
    if name == "colour" and channels != 3:
        name = "intensity"
    if name == "colour":
        return FeatureSpec(name, COLOUR_LEVELS**3, bits)
    if name == "gradient":
        return FeatureSpec(name, GRADIENT_LEVELS, bits, gradient_sigma_px)
    return FeatureSpec(name, 2**bits, bits)


def grey(image: NDArray[np.generic]) -> NDArray[np.generic]:
    """(H, W) intensity of an (H, W) or (H, W, C) image: the mean of the channels."""
    if image.ndim == 2:
        return image
    return np.asarray(np.rint(image.mean(axis=2)), dtype=image.dtype)


def feature_bins(image: NDArray[np.generic], spec: FeatureSpec) -> NDArray[np.intp]:
    """(H, W) histogram bin of every pixel."""
    if spec.name == "colour":
        level = image.astype(np.intp) * COLOUR_LEVELS >> spec.bits
        joint = level[..., 0] * COLOUR_LEVELS**2 + level[..., 1] * COLOUR_LEVELS + level[..., 2]
        return np.asarray(joint, dtype=np.intp)
    if spec.name == "gradient":
        magnitude = gradient_magnitude(grey(image), spec.sigma_px)
        # An ideal step over the sensor's whole range has slope range / (sqrt(2 pi) sigma) after smoothing.
        steepest = (2**spec.bits - 1) / (np.sqrt(2 * np.pi) * spec.sigma_px)
        level = magnitude * (GRADIENT_LEVELS / steepest)
        return np.asarray(np.minimum(level, GRADIENT_LEVELS - 1), dtype=np.intp)
    return np.asarray(np.minimum(grey(image), spec.n_bins - 1), dtype=np.intp)


def gradient_magnitude(image: NDArray[np.generic], sigma_px: float) -> NDArray[np.float32]:
    """(H, W) derivative image D_s: gradient magnitude after a Gaussian of ``sigma_px``, levels per pixel."""
    smooth = cv2.GaussianBlur(image.astype(np.float32), (0, 0), sigma_px)
    dx = cv2.Sobel(smooth, cv2.CV_32F, 1, 0, ksize=3, scale=0.125)
    dy = cv2.Sobel(smooth, cv2.CV_32F, 0, 1, ksize=3, scale=0.125)
    return np.asarray(np.hypot(dx, dy), dtype=np.float32)

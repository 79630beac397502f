"""From a frame to a measurement: the map log c (Eq. 3) and the constant of Eq. 2.

Two maps:

``histogram`` is the paper's: log p(D|f) - log p(D|b), p(D|b) empirical, p(D|f) uniform over the sensor's range.

``contrast`` puts the edge where the light falls to half of its local brightness. A point spread moves light over
the edge, and that light is nothing like sky, so the histogram map makes everything too large; half of the local
maximum is where the edge was before the blur, for every blur. Each pixel's say is bounded on both sides: parts
may be unlit (a low price for sky under the silhouette), light must be explained (a higher price for leaving it
out).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import TypeVar

import cv2
import numpy as np
from numpy.typing import NDArray

from service.imaging.background import Sky
from service.imaging.features import feature_bins
from service.imaging.halo import veil
from service.imaging.psf import estimate_psf_sigma

Number = TypeVar("Number", np.uint8, np.float32)

_DEFAULT_PSF_SIGMA_PX = 1.0
_DETECTION_SIGMA = 4.0  # of smoothed noise: fainter light is no evidence
_STRONG_SIGMA = 5.0  # light around which an edge can be placed; fainter light is judged by neighbourhoods
_DIM_SIGMA, _DIM_MOST_SIGMA = 3.0, 6.0  # mean of a dim surface nearby; brighter ones are told by single pixels
_SPECK_SIGMA, _SPECK_SHARE = 8.0, 1.5  # brighter, and so much more than what is around it: a part of its own
_LEVEL_ROUNDS = 8
_LEVEL_SAMPLE = 8_192
_LEVEL_PIXELS = 100  # fewer that look like sky tell nothing of its level
_FAINT_SIGMA_PX = 2.0
_FAINT_DETECTION = 3.5
_FAINT_NATS = 1.5
_HALF = 0.5  # share of the local maximum at which a blurred edge stands


@dataclass(frozen=True)
class FrameMaps:
    """What ``measure`` derives from one frame."""

    log_ratio: NDArray[np.float32]  # (H, W) Eq. 3
    log_background: float  # Eq. 2's constant: sum of log p(D|b) - log p(D)
    psf_sigma_px: float | None  # width of the point spread that was used
    brightness: Callable[[], NDArray[np.float32]] | None = None  # (H, W) above the sky, in units of a pixel's noise


def measure(
    image: NDArray[np.generic],
    sky: Sky,
    *,
    kind: str,
    psf_sigma_px: float | None,
    usual_psf_sigma_px: float | None = None,
    covered_empty_nats: float,
    uncovered_bright_nats: float,
    edge_nats_per_px: float | None = None,
) -> FrameMaps:
    """Measure a frame (H, W) or (H, W, C) against the sky.

    ``edge_nats_per_px``: see ``even_edge``, for a track that is followed; None where the whole space is searched.
    ``psf_sigma_px`` is the point-spread width where it is known; otherwise the frame's own estimate is averaged with
    ``usual_psf_sigma_px``, the one of the frames before.
    """
    log_background = log_constant(image, sky)
    if kind == "histogram":
        return FrameMaps(histogram_log_ratio(feature_bins(image, sky.spec), sky), log_background, None)
    residual = sky_residual(image, sky)
    if psf_sigma_px is None:
        seen = estimate_psf_sigma(contrast(residual, sky, 0.0))
        known = [width for width in (seen, usual_psf_sigma_px, usual_psf_sigma_px) if width is not None]
        psf_sigma_px = float(np.mean(known)) if known else _DEFAULT_PSF_SIGMA_PX
    log_ratio = contrast_log_ratio(
        residual,
        sky,
        psf_sigma_px=psf_sigma_px,
        covered_empty_nats=covered_empty_nats,
        uncovered_bright_nats=uncovered_bright_nats,
    )
    if edge_nats_per_px is not None:
        log_ratio = even_edge(log_ratio, covered_empty_nats, edge_nats_per_px)
    return FrameMaps(log_ratio, log_background, psf_sigma_px, partial(brightness, residual, sky))


def brightness(residual: NDArray[np.float32], sky: Sky) -> NDArray[np.float32]:
    """(H, W) light above the sky over all channels, in units of a pixel's noise."""
    weight = 1 / (sky.sigma * np.float32(np.sqrt(residual.shape[2])))
    return np.asarray(residual @ weight, np.float32)


def even_edge(log_ratio: NDArray[np.float32], least: float, rise: float) -> NDArray[np.float32]:
    """(H, W) the map with light worth at most ``least`` nats at its edge, and ``rise`` nats more per pixel inwards.

    Where dark costs less than light the best silhouette is one with its edges outside of most of the light's: the
    asymmetry that finds a half-lit body makes it too large. With like prices at the edge it lies in the middle.
    """
    depth = cv2.distanceTransform((log_ratio > 0).astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_3)
    inside = np.maximum(np.asarray(depth, np.float32) - 0.5, 0.0)  # of a pixel's centre at the edge: half a pixel
    return np.asarray(np.minimum(log_ratio, least + rise * inside), dtype=np.float32)


def log_constant(image: NDArray[np.generic], sky: Sky) -> float:
    """Log of Eq. 2's constant: the sum over the image of log p(D|b) - log p(D)."""
    counts = np.bincount(feature_bins(image, sky.spec).ravel(), minlength=sky.spec.n_bins)
    some = np.flatnonzero(counts)
    return float(counts[some] @ (sky.log_density[some] - np.log(counts[some] / counts.sum())))


def histogram_log_ratio(bins: NDArray[np.intp], sky: Sky) -> NDArray[np.float32]:
    """(H, W) log c = log p(D|f) - log p(D|b) with p(D|f) = 1 / n_bins (Eq. 3)."""
    return np.asarray(-np.log(sky.spec.n_bins) - sky.log_density[bins], dtype=np.float32)


def sky_residual(image: NDArray[np.generic], sky: Sky) -> NDArray[np.float32]:
    """(H, W, C) frame minus sky, the frame's own change of level and gradient taken out.

    A plane is fitted to the pixels that look like sky, about their median at first: a large object, or what a wide
    point spread carries out of it, would lift that of the whole image.
    """
    frame = (image[..., None] if image.ndim == 2 else image).astype(np.float32)
    residual = frame - sky.mean
    height, width = residual.shape[:2]
    every = max(1, int(np.sqrt(height * width / _LEVEL_SAMPLE)))  # a sample tells the level well enough
    some = residual[::every, ::every]
    y, x = np.mgrid[0:height:every, 0:width:every].astype(np.float32)
    x, y = 2 * x / max(1, width - 1) - 1, 2 * y / max(1, height - 1) - 1
    change = np.zeros((3, residual.shape[2]), np.float32)  # level, and gradients along x and y
    change[0] = np.median(some, axis=(0, 1))
    for _ in range(_LEVEL_ROUNDS):
        plane = change[0] + x[..., None] * change[1] + y[..., None] * change[2]
        near = np.all(np.abs(some - plane) < 3 * sky.sigma, axis=2)
        if np.count_nonzero(near) < _LEVEL_PIXELS:
            break
        left = some[near] - plane[near]
        step = _plane(x[near], y[near], left) if _wide(x[near], y[near]) else np.zeros_like(change)
        step[0] += np.median(left - step[0] - x[near][:, None] * step[1] - y[near][:, None] * step[2], axis=0)
        change = change + step
        if bool(np.all(np.abs(step) < 0.02 * sky.sigma)):
            break
    columns, rows = np.linspace(-1, 1, width, dtype=np.float32), np.linspace(-1, 1, height, dtype=np.float32)
    residual -= change[0] + columns[:, None] * change[1]
    residual -= rows[:, None, None] * change[2]
    return residual


def _wide(x: NDArray[np.float32], y: NDArray[np.float32]) -> bool:
    """Whether pixels lie in all quarters of the image, so that a gradient can be told."""
    quarters = np.bincount(2 * (y > 0) + (x > 0), minlength=4)
    return bool(np.all(quarters >= _LEVEL_PIXELS))


def _plane(x: NDArray[np.float32], y: NDArray[np.float32], values: NDArray[np.float32]) -> NDArray[np.float32]:
    """(3, C) least-squares coefficients of 1, x and y for ``values`` (M, C)."""
    basis = np.stack([np.ones_like(x), x, y]).astype(np.float64)
    return np.asarray(np.linalg.solve(basis @ basis.T, basis @ values), dtype=np.float32)


def contrast(residual: NDArray[np.float32], sky: Sky, smooth_px: float) -> NDArray[np.float32]:
    """(H, W) distance from the sky in units of one pixel's noise, over all channels, after a Gaussian."""
    if smooth_px > 0:
        residual = np.asarray(cv2.GaussianBlur(residual, (0, 0), smooth_px), np.float32).reshape(residual.shape)
    z = residual / sky.sigma
    return np.asarray(np.sqrt(np.einsum("ijc,ijc->ij", z, z)), dtype=np.float32)


def contrast_log_ratio(
    residual: NDArray[np.float32],
    sky: Sky,
    *,
    psf_sigma_px: float,
    covered_empty_nats: float,
    uncovered_bright_nats: float,
) -> NDArray[np.float32]:
    """(H, W) bounded log-ratio that changes sign where the light is half of its local maximum.

    Dim surfaces are taken as a whole, by neighbourhoods: by single pixels they come apart into specks, and a wrong pose
    that fills the bright parts alone would win.
    """
    sharp, significance = half_level(residual, sky, psf_sigma_px)
    light = (sharp > 0) & (significance > _STRONG_SIGMA)
    mean = cv2.GaussianBlur(significance, (0, 0), _FAINT_SIGMA_PX)
    speck = significance > np.maximum(_SPECK_SIGMA, _SPECK_SHARE * mean)
    light &= speck | (mean < _DIM_SIGMA) | (mean > _DIM_MOST_SIGMA)
    near_light = brightest_within(light.astype(np.uint8), psf_sigma_px) > 0
    clear = residual - veil(residual, sky, light, near_light, psf_sigma_px)
    faint = np.minimum(faint_light(clear, sky, near_light), _FAINT_NATS)
    far = np.maximum(half_level(clear, sky, psf_sigma_px)[0], faint)
    log_ratio = np.where(near_light, sharp, far)
    return np.asarray(np.clip(log_ratio, -covered_empty_nats, uncovered_bright_nats), dtype=np.float32)


def half_level(
    residual: NDArray[np.float32], sky: Sky, psf_sigma_px: float
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """(H, W) distance of each pixel from half of the light within reach of the point spread, in units of an edge's
    softness; and its brightness in units of its noise."""
    smooth = max(0.5, 0.7 * psf_sigma_px)
    s = contrast(residual, sky, smooth)
    noise = float(np.sqrt(residual.shape[2] / np.pi) / (2 * smooth))  # of a pixel after the Gaussian
    bright = cv2.GaussianBlur(brightest_within(s, psf_sigma_px), (0, 0), max(psf_sigma_px, 0.5))
    threshold = np.maximum(_HALF * bright, _DETECTION_SIGMA * noise)
    softness = np.maximum(0.075 * bright, 0.75 * noise)
    return np.asarray((s - threshold) / softness, dtype=np.float32), np.asarray(s / noise, dtype=np.float32)


def brightest_within(image: NDArray[Number], sigma_px: float) -> NDArray[Number]:
    """(H, W) the greatest value within 2.5 ``sigma_px`` of each pixel: as far as such a point spread carries."""
    side = 2 * int(np.ceil(2.5 * sigma_px)) + 1
    disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (side, side))
    return np.asarray(cv2.dilate(image, disc), dtype=image.dtype)


def faint_light(residual: NDArray[np.float32], sky: Sky, near_light: NDArray[np.bool_]) -> NDArray[np.float32]:
    """(H, W) evidence for parts too dim to be seen in single pixels: the mean over a neighbourhood that leaves out
    bright parts and what the point spread carries out of them, in units of its own noise."""
    weight = 1.0 - near_light.astype(np.float32)
    share = cv2.GaussianBlur(weight, (0, 0), _FAINT_SIGMA_PX)
    # A Gaussian squared is a Gaussian of sigma / sqrt(2) over 4 pi sigma^2.
    variance = cv2.GaussianBlur(weight, (0, 0), _FAINT_SIGMA_PX / np.sqrt(2)) / (4 * np.pi * _FAINT_SIGMA_PX**2)
    total = cv2.GaussianBlur(residual * weight[..., None], (0, 0), _FAINT_SIGMA_PX).reshape(residual.shape)
    z = total / sky.sigma / np.sqrt(np.maximum(variance, 1e-6))[..., None]
    usual = np.median(np.abs(z[::2, ::2]), axis=(0, 1))
    z = z / np.maximum(1.0, 1.4826 * usual)  # the sky's own structure is noise too
    significance = np.sqrt(np.einsum("ijc,ijc->ij", z, z))
    seen = np.where(weight > 0, significance, 0.0).astype(np.float32)
    bright = cv2.GaussianBlur(brightest_within(seen, _FAINT_SIGMA_PX), (0, 0), _FAINT_SIGMA_PX)
    threshold = np.maximum(_FAINT_DETECTION, _HALF * bright)
    evidence = (significance - threshold) / np.maximum(1.5, 0.15 * bright)
    return np.asarray(np.where((share > 0.2) & (weight > 0), evidence, -np.inf), dtype=np.float32)

"""Light and shade inside of an outline: how well a sunlit body, posed like this, explains a frame's brightness.

No texture is known, and neither is the sun's direction. Every face is taken for a matt surface of the same
reflectance (Lambert) under one distant light and an even one; the light is fitted to the frame for each pose anew.
What the best light leaves over tells poses apart whose outlines say the same: a wrong one cannot make the lit
and the dark parts fall where they are.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

SIDE_PX = 64  # of the patch at most: facets are flat, so coarse is enough
MARGIN = 0.25  # of the object's extent, on each side
LEAST_COMPONENT = 0.05  # of the largest one's area
COVERED = 0.3  # of a pixel, after the blur, from which on it counts
EVERY = 2  # pixels are enough
ROUNDS = 3
TOWARDS_SUN = np.array([[0, 0, -1], [0.87, 0, -0.5], [-0.43, 0.75, -0.5], [-0.43, -0.75, -0.5]])  # the first guesses
OUTLIER = 3.0  # medians of the residual, beyond which a pixel pulls no more than one there

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Patch:
    """The frame around the object, coarse: a pixel (x, y) of it is ``origin`` + (x, y) / ``zoom`` of the image."""

    brightness: NDArray[np.float32]  # (S, S) above the sky, in units of a pixel's noise
    light: NDArray[np.bool_]  # (S, S) where the frame speaks for an object
    origin: Floats  # (2,) px of the image
    zoom: float  # at most 1
    blur_px: float  # standard deviation of the point spread, px of the patch


def cut_patch(
    brightness: NDArray[np.float32],
    log_ratio: NDArray[np.float32],
    psf_sigma_px: float,
    side_px: int = SIDE_PX,
    margin: float = MARGIN,
) -> Patch | None:
    """What there is to shade: (H, W) ``brightness`` around the light in ``log_ratio``. None where there is none."""
    box = _extent(log_ratio > 0)
    if box is None:
        return None
    low, high = box
    half = 0.5 * float(np.max(high - low)) * (1 + 2 * margin) + 4.0
    zoom = min(1.0, side_px / (2 * half))
    side = int(np.ceil(2 * half * zoom))
    origin = 0.5 * (low + high) - half
    grid = ((np.arange(side) + 0.5) / zoom - 0.5).astype(np.float32)
    x, y = np.meshgrid(grid + np.float32(origin[0]), grid + np.float32(origin[1]))
    coarse = 0.4 / zoom if zoom < 1 else 0.0  # against aliasing: about a pixel of the patch
    smooth = cv2.GaussianBlur(brightness, (0, 0), coarse) if coarse else brightness
    inside = cv2.remap((log_ratio > 0).astype(np.float32), x, y, cv2.INTER_LINEAR)
    blur = zoom * float(np.hypot(max(psf_sigma_px, 0.5), coarse))
    cut = np.asarray(cv2.remap(smooth, x, y, cv2.INTER_LINEAR), np.float32)
    return Patch(cut, np.asarray(inside > 0.3, np.bool_), origin, zoom, blur)


def explained(patch: Patch, normals: NDArray[np.float32], covered: NDArray[np.float32]) -> float:
    """Log of how many times less of the brightness is left over by a shaded body than by none.

    ``normals`` (S, S, 3) unit vectors away from what each pixel of the patch sees, in the camera frame, and ``covered``
    (S, S) whether it sees the body; both are blurred here. Brightness is max(0, n . s) + a where covered, s and a free:
    least absolute deviations by reweighting, for a few first guesses of the sun's direction. For a Laplace
    distribution of unknown width the log-likelihood of n independent pixels is n times the answer.
    """
    spread = cv2.GaussianBlur(np.dstack([normals, covered]), (0, 0), patch.blur_px)
    region = cv2.dilate((patch.light | (spread[..., 3] > COVERED)).astype(np.uint8), np.ones((3, 3), np.uint8)) > 0
    some = np.flatnonzero(region)[::EVERY]
    if len(some) == 0:
        return 0.0
    seen = patch.brightness.ravel()[some].astype(np.float64)
    drawn = np.asarray(spread.reshape(-1, 4)[some], np.float64)
    normal, even = drawn[:, :3], drawn[:, 3:]
    total = float(np.abs(seen).sum())
    least, _ = _fit_light(normal, even, seen)
    return float(log_times_less(np.array(total), np.array(least)))


def log_times_less(total: Floats, least: Floats) -> Floats:
    """Log of how many times less of the ``total`` brightness the ``least`` is; nothing of nothing counts as 0."""
    return np.asarray(np.log(np.maximum(total, 1e-12) / np.maximum(np.minimum(least, total), 1e-12)))


def point_spread(blur_px: float) -> Floats:
    """Along one axis, as ``cv2.GaussianBlur`` has it: an odd number of taps, four standard deviations to each side."""
    return np.asarray(cv2.getGaussianKernel(round(8 * blur_px + 1) | 1, blur_px)[:, 0], np.float64)


def first_light(spread: Floats, seen: Floats) -> Floats:
    """(4,) share of the sun along each axis, and of the even light, that explain ``seen`` (n,) best.

    ``spread`` (n, 4) is blurred: normals, and how far a pixel is covered.
    """
    return _fit_light(spread[:, :3], spread[:, 3:], seen)[1]


def _fit_light(normal: Floats, even: Floats, seen: Floats) -> tuple[float, Floats]:
    """The least sum of absolute residuals, over the guesses and rounds, and the light (4,) that leaves it."""
    least, light = np.inf, np.zeros(4)
    sun, weight = TOWARDS_SUN, np.ones((len(TOWARDS_SUN), len(seen)))
    for _ in range(ROUNDS):  # of all guesses at once
        lit = sun @ normal.T > 0  # (G, n)
        basis = np.concatenate([lit[..., None] * normal, np.broadcast_to(even, (*lit.shape, 1))], axis=2)
        share = _least_squares(basis, seen, weight)
        left = np.abs(seen - np.einsum("gnk,gk->gn", basis, share))
        sums = left.sum(axis=1)
        if float(sums.min()) < least:
            least, light = float(sums.min()), share[int(np.argmin(sums))]
        weight = 1.0 / np.maximum(1.0, left / (OUTLIER * np.median(left, axis=1, keepdims=True) + 1e-9))
        sun = share[:, :3]
    return least, light


def _least_squares(basis: Floats, seen: Floats, weight: Floats) -> Floats:
    """(G, K) of ``basis`` (G, n, K) for ``seen`` (n,), each pixel with its ``weight`` (G, n)."""
    weighted = np.swapaxes(basis * weight[..., None], 1, 2)
    gram = weighted @ basis
    ridge = 1e-6 * np.trace(gram, axis1=1, axis2=2) + 1e-12
    gram = gram + ridge[:, None, None] * np.eye(gram.shape[1])
    return np.asarray(np.linalg.solve(gram, (weighted @ seen)[..., None])[..., 0], np.float64)


def _extent(light: NDArray[np.bool_]) -> tuple[Floats, Floats] | None:
    """Corners (x, y) of the box around the light, specks left out."""
    count, _, stats, _ = cv2.connectedComponentsWithStats(light.astype(np.uint8), connectivity=8)
    if count < 2:
        return None
    found = stats[1:].astype(np.float64)
    kept = found[found[:, cv2.CC_STAT_AREA] >= max(4.0, LEAST_COMPONENT * found[:, cv2.CC_STAT_AREA].max())]
    if len(kept) == 0:
        return None
    low = kept[:, [cv2.CC_STAT_LEFT, cv2.CC_STAT_TOP]]
    high = low + kept[:, [cv2.CC_STAT_WIDTH, cv2.CC_STAT_HEIGHT]]
    return low.min(axis=0), high.max(axis=0)

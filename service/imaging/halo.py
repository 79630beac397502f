"""Light that air and optics scatter far out of the object: the wings of the point spread.

The core of the point spread blurs an edge; its wings lay a faint veil around everything bright, many pixels wide. The
veil is nothing like sky and no part of the object either. It surrounds the light on all sides, which no dim part does:
that is how both are told apart.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from service.imaging.background import Sky

WIDTHS = (2.0, 4.0, 8.0)  # of the Gaussians that make up the wings, in widths of the core
LEAST_CORE_PX = 1.0
ROUNDS = 6
OUTLIER_SIGMA = 2.0  # what is brighter than the veil by more is a dim part or a star
FEWEST_PIXELS, MOST_PIXELS = 200, 2500
MOST_SCATTERED = 0.7  # of the light that is not: a fit that wants more takes dim parts of the object for it
REACH = 0.02  # of its greatest value: where a veil is not worth fitting


def veil(
    residual: NDArray[np.float32], sky: Sky, light: NDArray[np.bool_], near: NDArray[np.bool_], psf_sigma_px: float
) -> NDArray[np.float32]:
    """(H, W, C) scattered light in ``residual`` (H, W, C), the frame less the sky.

    ``light`` (H, W) are the object's pixels, ``near`` those that the point spread's core may reach from there. Outside
    of them the frame is fitted by the light spread out by Gaussians of ``WIDTHS``, none of them negative, by least
    squares; what stands out above the fit is left out of the next round.
    """
    source = np.where(light[..., None], residual, np.float32(0.0))
    core = max(psf_sigma_px, LEAST_CORE_PX)
    spread = np.stack([_blurred(source, width * core) for width in WIDTHS])  # (K, H, W, C)
    scattered = np.zeros_like(residual)
    total = np.abs(spread[-1]) @ np.ones(residual.shape[2], np.float32)
    around = np.flatnonzero(~near & (total > REACH * total.max()))
    if len(around) < FEWEST_PIXELS:
        return scattered
    around = around[:: -(-len(around) // MOST_PIXELS)]
    for channel in range(residual.shape[2]):
        basis = spread[..., channel].reshape(len(WIDTHS), -1)[:, around].astype(np.float64)
        share = _robust_share(basis, residual[..., channel].ravel()[around].astype(np.float64))
        share *= min(1.0, MOST_SCATTERED / max(float(share.sum()), 1e-9))
        scattered[..., channel] = np.tensordot(share, spread[..., channel], axes=1)
    return scattered


def _blurred(source: NDArray[np.float32], sigma_px: float) -> NDArray[np.float32]:
    """A Gaussian on a grid that is as coarse as the Gaussian allows."""
    height, width, channels = source.shape
    coarse = max(1, int(sigma_px / 2))
    size = -(-width // coarse), -(-height // coarse)
    small = cv2.resize(source, size, interpolation=cv2.INTER_AREA) if coarse > 1 else source
    small = cv2.GaussianBlur(small, (0, 0), sigma_px / coarse, borderType=cv2.BORDER_CONSTANT)
    full = cv2.resize(small, (width, height), interpolation=cv2.INTER_LINEAR) if coarse > 1 else small
    return np.asarray(full, dtype=np.float32).reshape(height, width, channels)


def _robust_share(basis: NDArray[np.float64], seen: NDArray[np.float64]) -> NDArray[np.float64]:
    """(K,) shares, none negative, with which (K, n) ``basis`` makes up (n,) ``seen``, outliers above left out."""
    kept = np.ones(len(seen), dtype=bool)
    share = np.zeros(len(basis))
    for _ in range(ROUNDS):
        share = _least_squares(basis[:, kept], seen[kept])
        rest = seen - share @ basis
        scale = 1.4826 * float(np.median(np.abs(rest[kept])))
        kept = rest < OUTLIER_SIGMA * max(scale, 1e-9)
    return share


def _least_squares(basis: NDArray[np.float64], seen: NDArray[np.float64]) -> NDArray[np.float64]:
    """Shares that are not negative: those that would be are taken out, most negative first."""
    share = np.zeros(len(basis))
    active = list(range(len(basis)))
    while active:
        a = basis[active]
        gram = a @ a.T
        solved = np.linalg.solve(gram + 1e-9 * np.trace(gram) * np.eye(len(active)), a @ seen)
        if solved.min() >= 0:
            share[active] = solved
            break
        del active[int(np.argmin(solved))]
    return share

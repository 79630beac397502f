"""The point spread K of docs/model.md, section 2: a Gaussian core, turbulent wings, and what both do to a drawing.

The transfer function exp(-k^2 s^2 / 2 - (k w)^(5/3)) belongs to a stable law of index 5/3, which is a mixture of
Gaussians; three of them hold it to 0.4 % of its height.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from math import factorial, sqrt

import cv2
import numpy as np
from numpy.typing import NDArray

Images = NDArray[np.float32]

# Weights, and widths in units of w, of the Gaussians whose sum is nearest to exp(-x^(5/3)) for x in 0 to 4.
# numerical: three Gaussians that hold the law of index 5/3 to 0.4 %
MIXTURE_WEIGHTS = (0.6246, 0.3227, 0.0527)
MIXTURE_WIDTHS = (1.164, 1.936, 5.691)
# exact: mean square width of the two inner ones, in units of w^2
_INNER = MIXTURE_WEIGHTS[0] * MIXTURE_WIDTHS[0] ** 2 + MIXTURE_WEIGHTS[1] * MIXTURE_WIDTHS[1] ** 2
_REACH = 5.5  # numerical: sigmas of a Gaussian that are summed: beyond lies less than a float32's rounding
_NARROWEST = 0.4  # numerical: px: of a narrower one the slopes fall between the pixels
# numerical: of a Gaussian's height: products below a float32's exponents take 30 times as long
LEAST = 1e-12


@dataclass(frozen=True)
class PointSpread:
    """Widths in patch pixels."""

    core: float  # s
    wings: float = 0.0  # w
    sharpened: float = 0.0  # p: amount of an unsharp mask that the frame has been through
    mask: float = 0.0  # m: its Gaussian's width

    def gaussians(self, low_pass: float) -> tuple[tuple[float, float], ...]:
        """(weight, sigma) of the Gaussians that K is, each widened by the frame's own low pass."""
        core = self.core**2 + low_pass**2
        weights, widths = ((1.0,), (0.0,)) if self.wings <= 0 else (MIXTURE_WEIGHTS, MIXTURE_WIDTHS)
        each = [(weight, core + (m * self.wings) ** 2) for weight, m in zip(weights, widths, strict=True)]
        if self.sharpened > 0:
            below = [(-self.sharpened * weight, square + self.mask**2) for weight, square in each]
            each = [((1 + self.sharpened) * weight, square) for weight, square in each] + below
        return tuple((weight, sqrt(square)) for weight, square in each)

    @classmethod
    def of(cls, width: float, share: float) -> PointSpread:
        """That of a width of whose square the wings have a share."""
        return cls(width * sqrt(1.0 - share), width * sqrt(share / _INNER))

    def transfer(self, wavenumbers: NDArray[np.float64]) -> NDArray[np.float64]:
        """K at such wavenumbers, 1 / px."""
        mask = 1 + self.sharpened * (1 - np.exp(-0.5 * (self.mask * wavenumbers) ** 2))
        optics = np.exp(-0.5 * (self.core * wavenumbers) ** 2 - (self.wings * wavenumbers) ** (5 / 3))
        return np.asarray(mask * optics)

    @property
    def width(self) -> float:
        """Root of the mean square width of its two inner Gaussians: what a pixel step is measured by, px."""
        return sqrt(self.core**2 + _INNER * self.wings**2)

    @property
    def share(self) -> float:
        """Of the width's square: the wings'."""
        return _INNER * self.wings**2 / self.width**2


def spread(images: Images, point_spread: PointSpread, low_pass: float) -> Images:
    """(..., S, S) drawings -> the same as the camera and the frame's low pass (Gaussian, px) leave them."""
    out = np.zeros_like(images)
    for weight, sigma in point_spread.gaussians(low_pass):
        smooth = taps(images.shape[-1], round(sigma, 4))
        out += _swept(images, smooth, np.float32(weight) * smooth)
    return out


def spread_slopes(images: Images, point_spread: PointSpread, low_pass: float) -> tuple[Images, Images, Images]:
    """``spread``, and its slopes along x and y: the Gaussians' own, so nothing is differenced."""
    blurred, dx, dy = (np.zeros_like(images) for _ in range(3))
    for weight, smooth, slope in gaussians_and_slopes(images.shape[-1], point_spread, low_pass):
        share = np.float32(weight)
        blurred += _swept(images, smooth, share * smooth)
        dx += _swept(images, slope, share * smooth)
        dy += _swept(images, smooth, share * slope)
    return blurred, dx, dy


def gaussians_and_slopes(side: int, point_spread: PointSpread, low_pass: float) -> list[tuple[float, Images, Images]]:
    """Weight of each Gaussian of which a blur is, its taps, and those of its slope."""
    each = point_spread.gaussians(low_pass)
    return [(weight, taps(side, round(sigma, 4)), slope_taps(side, round(sigma, 4))) for weight, sigma in each]


def _swept(images: Images, across: Images, down: Images) -> Images:
    """(..., S, S) correlated with taps along x and along y; beyond the border is nothing."""
    flat = np.ascontiguousarray(images, np.float32).reshape(-1, *images.shape[-2:])
    out = np.empty_like(flat)
    for one, to in zip(flat, out, strict=True):
        cv2.sepFilter2D(one, cv2.CV_32F, across, down, dst=to, borderType=cv2.BORDER_CONSTANT)
    return out.reshape(images.shape)


@lru_cache(maxsize=256)
def taps(side: int, sigma: float) -> Images:
    """(2 r + 1,) of a Gaussian blur, as far as it matters to a picture ``side`` px wide."""
    reach = _reach(side, sigma)
    kernel = np.exp(-0.5 * (reach / max(sigma, 1e-3)) ** 2)
    return _kept(kernel / kernel.sum())


@lru_cache(maxsize=256)
def slope_taps(side: int, sigma: float) -> Images:
    """(2 r + 1,) of its derivative by place; a ramp's is exact."""
    width = max(sigma, _NARROWEST)
    reach = _reach(side, width)
    kernel = reach * np.exp(-0.5 * (reach / width) ** 2)
    return _kept(kernel / (reach * kernel).sum())


def _reach(side: int, sigma: float) -> NDArray[np.int64]:
    radius = min(max(int(np.ceil(_REACH * sigma)), 1), side)
    return np.arange(-radius, radius + 1)


def _kept(kernel: NDArray[np.float64]) -> Images:
    out = kernel.astype(np.float32)
    out.flags.writeable = False
    return out


@lru_cache(maxsize=256)
def band(side: int, sigma: float) -> NDArray[np.float32]:
    """(side, side) Gaussian blur along one axis; beyond the border is nothing."""
    gap = np.subtract.outer(np.arange(side), np.arange(side)).astype(np.float64)
    if sigma < 1e-3:
        return np.eye(side, dtype=np.float32)
    kernel = np.exp(-0.5 * (gap / sigma) ** 2)
    kernel[kernel < LEAST] = 0.0
    reach = np.arange(-side, side + 1)
    matrix = np.asarray(kernel / np.exp(-0.5 * (reach / sigma) ** 2).sum(), np.float32)
    matrix.flags.writeable = False
    return matrix


def gradient(image: Images) -> tuple[Images, Images]:
    """Central differences along x and y of (..., S, S)."""
    dx, dy = np.zeros_like(image), np.zeros_like(image)
    dx[..., :, 1:-1] = 0.5 * (image[..., :, 2:] - image[..., :, :-2])
    dy[..., 1:-1, :] = 0.5 * (image[..., 2:, :] - image[..., :-2, :])
    return dx, dy


def deviations(light: Images, width: float) -> Images:
    """(12, S, S) Gauss-Hermite deviations of the point spread, orders 2 to 4: s^n d^n I / sqrt(a! b!)."""
    along: list[Images] = [light]
    for _ in range(4):
        along.append(gradient(along[-1])[0])
    out = []
    for order in (2, 3, 4):
        for b in range(order + 1):
            image = along[order - b]
            for _ in range(b):
                image = gradient(image)[1]
            out.append(np.float32(width**order / sqrt(factorial(order - b) * factorial(b))) * image)
    return np.stack(out)

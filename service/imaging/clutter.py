"""A body before clutter: which pixels look like the body's, and which like what lies about it (docs/model.md, 7).

The paper's Eq. 3 with both densities learnt: log c = log p(D|f) - log p(D|b), D a pixel's colour, or its grey and how
rough it is thereabouts. They are learnt in the frame in which a box about the body was told.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from service.imaging.own_sky import surface_through

Map = NDArray[np.float32]
Bins = NDArray[np.intp]
Mask = NDArray[np.bool_]
Box = tuple[int, int, int, int]  # x, y, width, height; px

_LEVELS, _GREYS, _ROUGH = 16, 32, 8  # numerical: of a colour's channel; of grey, and octaves of roughness
SIZES = (_LEVELS**3, _GREYS * _ROUGH)  # exact: values of either feature
_SMOOTH_PX = 1.0  # prior: light is at least so smooth
_ENDS = (0.1, 99.9)  # numerical: per cent of a frame's values: the ends of the scale of its colours
_FINEST_SLOPE = 0.25  # numerical: of 256 levels a pixel: below it all is smooth
_UNSEEN = 50.0  # prior: pixels that a density is worth before any is seen: it is that of all pixels together
_EVEN = 0.02  # prior: of it, alike for all values
_MOST = 3.0  # prior: nats; no pixel says more: one in twenty shows a colour that neither has shown
_AROUND = 0.35  # prior: of a box's longer side: clutter that may lie behind the body as well
_FAR = 0.2  # prior: what a pixel of clutter further off counts
_MIDDLE, _EDGE = 0.9, 0.2  # prior: share of bodies that cover the middle of their box, and its edge
# prior: power of what is about a box against what is in it, a pixel: of 29 skies the loudest (day, clouds) has 0.03, of
# four rooms and eleven grounds the quietest 0.06
_LOUD = 0.05
_LOUD_PX = 4.0  # prior: stars and noise are finer
_ROUNDS = 20  # numerical: of telling a box's body from its clutter


@dataclass(frozen=True)
class Palette:
    """What body and clutter look like: logarithms of densities over the feature's values, and its grey levels."""

    body: Map  # (B,)
    clutter: Map  # (B,)
    low: float  # counts that are 0 of 256 levels
    span: float  # counts of all of them

    def log_ratio(self, bins: Bins) -> Map:
        """(H, W) log c of a frame's ``features``."""
        return np.asarray(np.clip(self.body - self.clutter, -_MOST, _MOST)[bins], np.float32)

    def learnt(self, bins: Bins, inside: Map, kept: float) -> Palette:
        """With one more frame's pixels, ``inside`` (H, W) the share of each that is the body's.

        ``kept``: of what was known; 0: nothing of it.
        """
        together = _shares(bins, np.ones_like(inside), len(self.body))
        body, clutter = (
            np.log(kept * np.exp(old) + (1 - kept) * _density(_counts(bins, weight, len(old)), together))
            for old, weight in ((self.body, inside**2), (self.clutter, (1 - inside) ** 2))
        )
        return Palette(body.astype(np.float32), clutter.astype(np.float32), self.low, self.span)


def cluttered_box(image: NDArray[np.generic], known: Mask) -> Box | None:
    """The box in which the body lies, of a frame (H, W) or (H, W, C) that shows what else there is where it is
    ``known`` (H, W).

    None where that is not all about a box, or is sky: smooth, but for what is small or faint beside the body.
    """
    box = told_box(known)
    if box is None:
        return None
    channels = np.moveaxis(np.atleast_3d(np.asarray(image, np.float32)), 2, 0)
    power = sum(cv2.GaussianBlur(one - surface_through(one, known), (0, 0), _LOUD_PX) ** 2 for one in channels)
    return box if float(power[known].mean()) >= _LOUD * float(power[~known].mean()) else None


def told_box(known: Mask) -> Box | None:
    """The one box (x, y, width, height) that is not ``known`` (H, W); None: it is no box, or a margin's inside."""
    columns, rows = (np.flatnonzero(~known.all(axis=axis)) for axis in (0, 1))
    if not len(rows):
        return None
    x, y, width, height = int(columns[0]), int(rows[0]), int(np.ptp(columns)) + 1, int(np.ptp(rows)) + 1
    whole = not known[y : y + height, x : x + width].any()
    margin = x == y == known.shape[1] - x - width == known.shape[0] - y - height
    return (x, y, width, height) if whole and not margin else None


def palette_of(image: NDArray[np.generic], box: Box) -> Palette:
    """Of a frame whose body is told to lie in a box: what is about the box is clutter, and may lie in it as well.

    Expectation and maximisation: which pixels of the box are the body's, and what colours each has.
    """
    low, high = (float(v) for v in np.percentile(np.asarray(image, np.float32), _ENDS))
    span = max(high - low, 1.0)
    bins, size = features(image, low, span), _size(image)
    inside, near = within(bins.shape, box), within(bins.shape, box, _AROUND)
    together = _shares(bins[near], np.ones(np.count_nonzero(near), np.float32), size)
    outside = _counts(bins, np.where(inside, 0.0, np.where(near, 1.0, _FAR)).astype(np.float32), size)
    held, share = bins[inside], _filled(box, bins.shape)[inside]
    body, clutter, weight = np.ones(size), np.ones(size), share
    for _ in range(_ROUNDS):
        body = _density(_counts(held, weight, size), together)
        clutter = _density(outside + _counts(held, 1 - weight, size), together)
        weight = (share * body[held] / (share * body[held] + (1 - share) * clutter[held])).astype(np.float32)
    return Palette(np.log(body).astype(np.float32), np.log(clutter).astype(np.float32), low, span)


def _filled(box: Box, shape: tuple[int, ...]) -> Map:
    """(H, W) share of bodies told by a box that cover a pixel: most its middle, few its edges."""
    x, y, width, height = box
    across = (np.arange(shape[1]) + 0.5 - x - 0.5 * width) / (0.5 * width)
    down = (np.arange(shape[0]) + 0.5 - y - 0.5 * height) / (0.5 * height)
    off = np.maximum(np.abs(across)[None], np.abs(down)[:, None])
    return np.asarray(np.clip(_MIDDLE - (_MIDDLE - _EDGE) * off**2, _EDGE, _MIDDLE), np.float32)


def within(shape: tuple[int, ...], box: Box, about: float = 0.0) -> Mask:
    """(H, W) the pixels of a box, and about it by a share of its longer side."""
    x, y, width, height = box
    far = round(about * max(width, height))
    mask = np.zeros(shape[:2], bool)
    mask[max(y - far, 0) : y + height + far, max(x - far, 0) : x + width + far] = True
    return mask


def levels(image: NDArray[np.generic], low: float, span: float) -> Map:
    """Of 256, what ``low`` and ``span`` of a palette make of counts of any shape."""
    return np.asarray(np.clip((image.astype(np.float32) - low) * np.float32(255 / span), 0, 255), np.float32)


def features(image: NDArray[np.generic], low: float, span: float) -> Bins:
    """(H, W) which of the feature's values a pixel shows: its colour, or its grey and how rough it is there."""
    smooth = _smooth(image, low, span)
    if image.ndim == 3:
        red, green, blue = np.moveaxis((smooth * (_LEVELS / 256)).astype(np.intp), 2, 0)
        return np.asarray((red * _LEVELS + green) * _LEVELS + blue)
    across, down = _slopes(smooth)
    slope = np.sqrt(cv2.GaussianBlur(across**2 + down**2, (0, 0), _SMOOTH_PX))
    rough = np.clip(np.log2(slope / _FINEST_SLOPE + 1), 0, _ROUGH - 1)
    return np.asarray((smooth * (_GREYS / 256)).astype(np.intp) * _ROUGH + rough.astype(np.intp))


def edges(image: NDArray[np.generic], low: float, span: float) -> NDArray[np.float32]:
    """(3, H, W) squares of slopes xx, xy, yy, levels a pixel, summed over channels."""
    x, y = (slope.reshape(*image.shape[:2], -1) for slope in _slopes(_smooth(image, low, span)))
    return np.stack([(x * x).sum(axis=2), (x * y).sum(axis=2), (y * y).sum(axis=2)])


def _smooth(image: NDArray[np.generic], low: float, span: float) -> Map:
    return np.asarray(cv2.GaussianBlur(levels(image, low, span), (0, 0), _SMOOTH_PX), np.float32)


def _slopes(smooth: Map) -> tuple[Map, Map]:
    """Across and down, levels a pixel, of each channel."""
    across, down = (cv2.Sobel(smooth, cv2.CV_32F, i, 1 - i, scale=0.125) for i in (1, 0))
    return np.asarray(across, np.float32), np.asarray(down, np.float32)


def _size(image: NDArray[np.generic]) -> int:
    return SIZES[0] if image.ndim == 3 else SIZES[1]


def _counts(bins: Bins, weight: Map, size: int) -> NDArray[np.float64]:
    return np.asarray(np.bincount(bins.ravel(), weights=weight.ravel().astype(np.float64), minlength=size), np.float64)


def _shares(bins: Bins, weight: Map, size: int) -> NDArray[np.float64]:
    counts = _counts(bins, weight, size)
    return np.asarray(counts / counts.sum())


def _density(counts: NDArray[np.float64], together: NDArray[np.float64]) -> NDArray[np.float64]:
    """Of so many pixels of each value, and of those of both together where few were seen."""
    unseen = (1 - _EVEN) * together + _EVEN / len(together)
    return np.asarray((counts + _UNSEEN * unseen) / (counts.sum() + _UNSEEN))

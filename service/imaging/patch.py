"""The part of a frame that holds the object's light, above the sky, at the resolution that the model is drawn in."""

from __future__ import annotations

from bisect import bisect_left
from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray

from service.imaging.full import upper_end
from service.imaging.margins import either, margins_under
from service.imaging.noise import checkerboard, louder, loudness, weights
from service.imaging.own_sky import fitted
from service.imaging.sky import Sky

Map = NDArray[np.float32]

# numerical: looked at for a level of the sky; share of the half width
_LEVEL_PIXELS, _LEVEL_BORDER = 4_096, 0.15
_LEVEL_ROUNDS, _LEVEL_SIGMAS = 3, 3.0  # numerical
_LEAST_BRIGHT_PX = 64  # numerical: from which light's own noise is told
_LOCAL_PX, _BRIGHT_SIGMAS = 1.5, 6.0  # numerical: level of light of which noise is told: over, and above, so much
_LEAST_PHOTON, _SLOPES = 1e-3, 40  # numerical: of the sky's noise, at the least; grid from there to that noise
_QUARTILE = 0.1015  # exact: lower quartile of a normal deviate's square
_MARGIN = 0.3  # numerical: sky on each side of the light, as a share of its longer side
_LEAST_MARGIN_PX = 6  # numerical
LANES = 16  # exact: a side is a multiple, rows of whole lanes
OWN = 64  # numerical: above all numbers of stars
_BRIGHTEST = 2.0  # numerical: of the sky's level: what is brighter are stars and hot pixels
_COARSER = 1.2  # numerical: a patch coarser by less saves nothing


@dataclass(frozen=True)
class Light:
    """A frame's light above the empty sky, (H, W), all channels as one; counts."""

    image: Map
    sigma: float  # noise of one pixel of empty sky, counts
    photon: float  # variance per count of light, counts
    sky: float  # counts of the empty sky, with what the sensor adds to it
    full: NDArray[np.bool_]  # at the sensor's upper end: at least so much
    origin: tuple[int, int] = (0, 0)  # its first pixel in the frame, where it is part of one
    stars: NDArray[np.uint8] | None = None
    """Numbers of its pieces that may be stars, 0 elsewhere; ``OWN`` more of those that the object has, if it is there.
    """
    unseen: NDArray[np.bool_] | None = None  # where nothing is known: under a clock, in a black bar; None: nowhere
    uneven: Map | None = None  # counts of the empty sky at a place, over ``sky``; None: alike everywhere

    def covers(self, square: Square) -> bool:
        """Whether a square lies within it."""
        (x, y), (left, top), size = square.first, self.origin, square.across
        height, width = self.image.shape
        return left <= x and top <= y and x + size <= left + width and y + size <= top + height


@dataclass(frozen=True)
class Square:
    """Part of a frame, to be drawn more coarsely."""

    first: tuple[int, int]  # corner, frame px
    across: int  # a side, frame px
    side: int  # the same, patch px


@dataclass(frozen=True)
class Patch:
    """A square of the frame, its pixels means over ``binning`` frame px a side; counts per frame pixel."""

    image: Map  # (S, S)
    sigma: float  # noise of one patch pixel
    photon: float
    sky: float  # counts of a frame pixel
    full: Map  # (S, S) share of it that is at the sensor's upper end
    unseen: NDArray[np.bool_]  # (S, S) where nothing is known
    stars: NDArray[np.uint8]  # (S, S) numbers of pieces of light that may be stars, 0 elsewhere
    stars_alone: NDArray[np.uint8] | None  # (S, S) the same where the object is absent; None: no more
    origin: tuple[float, float]  # of its first corner, frame px
    binning: float  # frame px a patch px
    uneven: Map | None = None  # (S, S) counts of the empty sky at a place, over ``sky``; None: alike everywhere

    @property
    def side(self) -> int:
        """S."""
        return len(self.image)


def light_of(image: NDArray[np.generic], sky: Sky, bits: int, region: tuple[slice, slice] | None = None) -> Light:
    """The light above the sky: channels weighed by their precision, so that the noise of the sum is least.

    ``region``: rows and columns; nothing else is looked at.
    """
    rows, columns = region or (slice(0, image.shape[0]), slice(0, image.shape[1]))
    whole = image[..., None] if image.ndim == 2 else image
    data, mean = np.asarray(whole[rows, columns], np.float32), sky.mean[rows, columns]
    weight = weights(sky.covariance)
    share = weight.astype(np.float32)
    sigma = float(np.sqrt(weight @ sky.covariance @ weight))
    above = _weighed(data - mean, share)
    unseen = either(sky.unsure, margins_under(whole, sky.mean, sky.sigma))
    unseen = None if unseen is None else unseen[rows, columns]
    above -= _own_level(above, sigma, None if unseen is None else ~unseen)
    if unseen is not None:
        above[unseen] = 0.0
        data = np.where(unseen[..., None], mean, data)
    full = np.any(data >= upper_end(data, mean, sky.sigma, sky.step, (1 << bits) - 1), axis=2)
    fine, local = checkerboard(above), np.asarray(cv2.GaussianBlur(above, (0, 0), _LOCAL_PX), np.float32)
    every = _thinned(above.size)
    empty = np.abs(local[::every, ::every]) <= _BRIGHT_SIGMAS * sigma
    empty = empty if unseen is None else empty & ~unseen[::every, ::every]
    shown = fine[::every, ::every][empty]
    sigma *= louder(loudness(shown) / sigma, sky.fine, len(shown))
    empty_sky = _weighed(mean, share)
    level = max(float(np.median(empty_sky[::every, ::every])), 0.0)
    dark = min(_darkest(local, sigma), level)
    photon = _photon_transfer(fine, local, sigma, full)
    photon = min(photon, sigma**2 / dark) if dark > sigma else photon  # sky that is hidden had no more than all noise
    uneven = np.clip(empty_sky / level, 0.0, _BRIGHTEST, out=empty_sky) if level > 0 else None
    return Light(above, sigma, photon, level, full, (columns.start, rows.start), unseen=unseen, uneven=uneven)


def _weighed(channels: Map, share: Map) -> Map:
    """(H, W) sum of channels (H, W, C), each times its share (C,)."""
    if len(share) == 1:  # NumPy's product takes as long as all else that is asked of a frame
        return np.asarray(channels[..., 0] * share[0], np.float32)
    return np.asarray(channels @ share, np.float32)


def _thinned(size: int) -> int:
    """Step from row to row, and column to column, at which so many pixels still tell a level well enough."""
    return max(1, int(np.sqrt(size / _LEVEL_PIXELS)))


def _own_level(above: Map, sigma: float, seen: NDArray[np.bool_] | None) -> Map:
    """(H, W), or (1, 1): by how much a frame's sky differs from the learnt one. A plane, as of moonlight and haze.

    Guessed from the border, where the object seldom is, then fitted to all that looks like such a sky. Where most of
    the border does not, it is no plane that has changed, and nothing is taken away.
    """
    every = _thinned(above.size)
    across, down, terms, edge = _plane_of(above.shape, every)
    some = above[::every, ::every]
    there = np.ones(some.shape, np.bool_) if seen is None else seen[::every, ::every]
    edge = edge & there if (edge & there).any() else there
    if not edge.any():
        return np.zeros((1, 1), np.float32)
    plane = fitted(terms[:, edge], some[edge])[0]
    for _ in range(_LEVEL_ROUNDS):
        sky = there & (np.abs(some - np.tensordot(plane, terms, 1)) < _LEVEL_SIGMAS * sigma)
        if np.count_nonzero(sky & edge) < 0.5 * np.count_nonzero(edge):
            return np.zeros((1, 1), np.float32)
        columns = terms[:, sky].astype(np.float64)
        plane = np.asarray(np.linalg.lstsq(columns @ columns.T, columns @ some[sky], rcond=None)[0], np.float64)
    level, right, below = plane.astype(np.float32)
    return np.asarray((level + right * across) + (below * down)[:, None], np.float32)


@lru_cache(maxsize=16)
def _plane_of(shape: tuple[int, ...], every: int) -> tuple[Map, Map, Map, NDArray[np.bool_]]:
    """Places across and down an image, -1 to 1; of each so many: level and slopes (3, h, w), and the border (h, w)."""
    across, down = (np.linspace(-1, 1, size, dtype=np.float32) for size in shape[::-1])
    x, y = np.meshgrid(across[::every], down[::every])
    edge = np.maximum(np.abs(x), np.abs(y)) > 1 - _LEVEL_BORDER
    return across, down, np.stack([np.ones_like(x), x, y]), edge


def _darkest(local: Map, sigma: float) -> float:
    """Counts below the sky that enough pixels reach: so much of its light, at the least, is hidden by a body.

    0 where that is no more than ``sigma``, as by night: then hardly a pixel is looked at twice.
    """
    below, enough = local[local < -sigma], min(_LEAST_BRIGHT_PX, local.size)
    return -float(np.partition(below, enough - 1)[enough - 1]) if len(below) >= enough else 0.0


def _photon_transfer(fine: Map, local: Map, sigma: float, full: NDArray[np.bool_]) -> float:
    """Variance per count of light, from the finest checkerboard, to which the point spread lets little through, and the
    level of light about it.

    Edges leak into it, so its lower quartile is believed (0.1015 of a Gaussian's variance); ``full`` pixels have none.
    Where the frame has too little light to tell, a thousandth of the sky's own noise.
    """
    bright = local > _BRIGHT_SIGMAS * sigma
    if full.any():
        bright &= cv2.dilate(full.astype(np.uint8), np.ones((3, 3), np.uint8)) == 0
    least = _LEAST_PHOTON * sigma
    if np.count_nonzero(bright) < _LEAST_BRIGHT_PX:
        return least
    square, light = fine[bright] ** 2, local[bright]
    slopes, quarter = np.geomspace(least, sigma, _SLOPES), len(light) // 4

    def above_quartile(k: int) -> float:
        """Falls as slopes rise."""
        return float(np.partition(square / (sigma**2 + slopes[k] * light), quarter)[quarter]) - _QUARTILE

    k = bisect_left(range(len(slopes)), 0.0, key=lambda k: -above_quartile(k))
    near = range(max(k - 1, 0), min(k + 1, len(slopes)))
    return float(slopes[min(near, key=lambda k: abs(above_quartile(k)))])


def square_around(centre: tuple[float, float], span_px: float, wanted: float) -> Square:
    """The square around ``centre`` that holds a body spanning ``span_px``, in which it spans about ``wanted``."""
    binning = span_px / wanted if span_px > _COARSER * wanted else 1.0
    margin = max(_MARGIN * span_px, _LEAST_MARGIN_PX * binning)
    side = int(np.ceil((span_px + 2 * margin) / binning))
    side += -side % LANES
    across = round(side * binning)
    x, y = (int(np.floor(c - 0.5 * across)) for c in centre)
    return Square((x, y), across, side)


def cut(light: Light, centre: tuple[float, float], span_px: float, wanted: float) -> Patch:
    """The light of a square (``square_around``); what lies beyond ``light`` is not known."""
    square = square_around(centre, span_px, wanted)
    binning, size = square.across / square.side, (square.side, square.side)
    height, width = light.image.shape
    columns, rows = (square.first[k] - light.origin[k] + np.arange(square.across) for k in (0, 1))
    inside = ((rows >= 0) & (rows < height))[:, None] & ((columns >= 0) & (columns < width))[None]
    index = np.ix_(np.clip(rows, 0, height - 1), np.clip(columns, 0, width - 1))
    image, full = (np.where(inside, one[index], 0).astype(np.float32) for one in (light.image, light.full))
    uneven = light.uneven
    if uneven is not None:
        uneven = np.asarray(cv2.resize(uneven[index], size, interpolation=cv2.INTER_AREA), np.float32)
    unseen = ~inside if light.unseen is None else light.unseen[index] | ~inside
    marked = np.zeros((1, 1), np.uint8) if light.stars is None else np.where(inside, light.stars[index], 0)
    stars = np.asarray(cv2.resize(np.asarray(marked, np.uint8), size, interpolation=cv2.INTER_NEAREST), np.uint8)
    return Patch(
        image=np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), np.float32),
        sigma=light.sigma / binning,
        photon=light.photon / binning**2,
        sky=light.sky,
        full=np.asarray(cv2.resize(full, size, interpolation=cv2.INTER_AREA), np.float32),
        unseen=cv2.resize(unseen.astype(np.float32), size, interpolation=cv2.INTER_AREA) > 0,
        stars=np.where(stars < OWN, stars, np.uint8(0)),
        stars_alone=stars % np.uint8(OWN) if stars.max() > OWN else None,
        origin=(float(square.first[0]), float(square.first[1])),
        binning=binning,
        uneven=uneven,
    )

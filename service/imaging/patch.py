"""The part of a frame that holds the object's light, above the sky, at the resolution that the model is drawn in."""

from __future__ import annotations

from bisect import bisect_left
from dataclasses import dataclass, replace
from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray

from service.imaging.background import Sky
from service.imaging.own_sky import fitted

Map = NDArray[np.float32]

DETECTION_SIGMAS = 5.0
"""Light counts as detected from here on, after a smoothing by one pixel: one false pixel in a few million."""
_SMOOTH_PX = 1.0
_LEVEL_PIXELS, _LEVEL_BORDER = 4_096, 0.15  # looked at for a frame's own level; share of the half width
_LEVEL_ROUNDS, _LEVEL_SIGMAS = 3, 3.0
_SMOOTHED_SIGMA = 1.0 / (2.0 * np.sqrt(np.pi) * _SMOOTH_PX)  # of white noise of unit variance after it
_LEAST_AREA_PX = 9
_NEAR = 0.35  # components nearer than this share of the object's diagonal belong to it: booms and panels half in shadow
_STAR_PX = 11  # extent of a bright star above the threshold
_NEAR_STAR = 0.06  # share of the diagonal within which even something so small belongs to the object
_ALMOST_ALL = 0.95  # of a frame's light: what a search's wider sight holds
_LEAST_BRIGHT_PX = 64
_MARGIN = 0.3  # sky on each side of the light, as a share of its longer side
_LEAST_MARGIN_PX = 6
MOST_STARS = 31  # that are told apart
_COARSER = 1.2  # numerical: a patch coarser by less saves nothing


@dataclass(frozen=True)
class Light:
    """A frame's light above the empty sky, (H, W), all channels as one; counts."""

    image: Map
    sigma: float  # noise of one pixel of empty sky, counts
    photon: float  # variance per count of light, counts
    hidden: float  # most light of the sky that a body can hide, counts
    censored: NDArray[np.bool_]  # at the sensor's upper end: at least so much
    origin: tuple[int, int] = (0, 0)  # its first pixel in the frame, where it is part of one
    stars: NDArray[np.uint8] | None = None  # numbers of its pieces that may be stars, 0 elsewhere

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
class Box:
    """Where the object's light is, frame pixels (outer corners)."""

    left: float
    top: float
    right: float
    bottom: float

    @property
    def side(self) -> float:
        """The longer side, px."""
        return max(self.right - self.left, self.bottom - self.top)

    @property
    def centre(self) -> tuple[float, float]:
        """Its middle, px."""
        return 0.5 * (self.left + self.right), 0.5 * (self.top + self.bottom)


@dataclass(frozen=True)
class Pieces:
    """Connected light of a frame, N pieces."""

    boxes: NDArray[np.float64]  # (N, 4) left, top, right, bottom, in the light's own pixels
    total: NDArray[np.float64]  # (N,) light, in units of its noise
    labels: NDArray[np.int32]  # (H, W) which of all connected light a pixel is of
    numbers: NDArray[np.intp]  # (N,) what the N are called there

    @property
    def extent(self) -> NDArray[np.float64]:
        """(N,) longer sides, px."""
        return np.asarray((self.boxes[:, 2:] - self.boxes[:, :2]).max(axis=1, initial=0))

    def stars_of(self, light: Light, box: Box | None) -> Light:
        """The light with what may be stars told apart: all that is as small and lies outside of the object's box."""
        x, y = light.origin
        nothing = (np.inf, np.inf, -np.inf, -np.inf)
        within = nothing if box is None else (box.left - x, box.top - y, box.right - x, box.bottom - y)
        outside = _beyond(self.boxes, np.array(within))
        order = np.argsort(-self.total)
        order = order[outside[order] & (self.extent[order] <= _STAR_PX)][:MOST_STARS]
        if not len(order):
            return light
        named = np.zeros(int(self.labels.max()) + 1, np.uint8)
        named[self.numbers[order]] = 1 + np.arange(len(order))
        return replace(light, stars=named[self.labels])


@dataclass(frozen=True)
class Patch:
    """A square of the frame, its pixels means over ``binning`` frame px a side; counts per frame pixel."""

    image: Map  # (S, S)
    sigma: float  # noise of one patch pixel
    photon: float
    hidden: float
    censored: NDArray[np.bool_]  # (S, S)
    stars: NDArray[np.uint8]  # (S, S) numbers of pieces of light that may be stars, 0 elsewhere
    origin: tuple[float, float]  # of its first corner, frame px
    binning: float  # frame px a patch px

    @property
    def side(self) -> int:
        """S."""
        return len(self.image)


def light_of(image: NDArray[np.generic], sky: Sky, bits: int, region: tuple[slice, slice] | None = None) -> Light:
    """The light above the sky: channels weighed by their precision, so that the noise of the sum is least.

    ``region``: rows and columns; nothing else is looked at.
    """
    rows, columns = region or (slice(0, image.shape[0]), slice(0, image.shape[1]))
    data, mean = np.asarray(image[rows, columns], np.float32), sky.mean[rows, columns]
    data = data[..., None] if data.ndim == 2 else data
    weight = 1.0 / np.diag(sky.covariance)
    weight /= weight.sum()
    share = weight.astype(np.float32)
    sigma = float(np.sqrt(weight @ sky.covariance @ weight))
    above = np.asarray((data - mean) @ share, np.float32)
    above -= _own_level(above, sigma)
    photon = _photon_transfer(above, sigma)
    level = max(float(np.median(mean @ share)), 0.0)
    hidden = min(level, sigma**2 / photon)
    censored = data.max(axis=2) >= (1 << bits) - 1
    return Light(above, sigma, photon, hidden, censored, (columns.start, rows.start))


def _own_level(above: Map, sigma: float) -> Map:
    """(H, W), or (1, 1): by how much a frame's sky differs from the learnt one. A plane, as of moonlight and haze.

    Guessed from the border, where the object seldom is, then fitted to all that looks like such a sky. Where most of
    the border does not, it is no plane that has changed, and nothing is taken away.
    """
    every = max(1, int(np.sqrt(above.size / _LEVEL_PIXELS)))  # a sample tells the level well enough
    across, down, terms, edge = _plane_of(above.shape, every)
    some = above[::every, ::every]
    plane = fitted(some, terms, edge)[0]
    for _ in range(_LEVEL_ROUNDS):
        sky = np.abs(some - np.tensordot(plane, terms, 1)) < _LEVEL_SIGMAS * sigma
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


def _photon_transfer(above: Map, sigma: float) -> float:
    """Variance per count of light, from the finest checkerboard, to which the point spread lets little through.

    Edges leak into it, so its lower quartile is believed (0.1015 of a Gaussian's variance). Where the frame has too
    little light to tell, a thousandth of the sky's own noise.
    """
    fine = cv2.filter2D(above, cv2.CV_32F, np.outer([1, -2, 1], [1, -2, 1]).astype(np.float32) / 6.0)
    local = cv2.GaussianBlur(above, (0, 0), 1.5)
    bright = local > 6 * sigma
    least = 1e-3 * sigma
    if np.count_nonzero(bright) < _LEAST_BRIGHT_PX:
        return least
    square, light = fine[bright] ** 2, local[bright]
    slopes, quarter = np.geomspace(least, sigma, 40), len(light) // 4

    def above_quartile(k: int) -> float:
        """Falls as slopes rise."""
        return float(np.partition(square / (sigma**2 + slopes[k] * light), quarter)[quarter]) - 0.1015

    k = bisect_left(range(len(slopes)), 0.0, key=lambda k: -above_quartile(k))
    near = range(max(k - 1, 0), min(k + 1, len(slopes)))
    return float(slopes[min(near, key=lambda k: abs(above_quartile(k)))])


def pieces_of(light: Light) -> Pieces:
    """What is connected and stands out of the noise; dark as well as light."""
    z = light.image / np.float32(light.sigma)
    smooth = np.abs(cv2.GaussianBlur(z, (0, 0), _SMOOTH_PX)) / np.float32(_SMOOTHED_SIGMA)
    count, labels, stats, _ = cv2.connectedComponentsWithStats((smooth > DETECTION_SIGMAS).astype(np.uint8))
    total = np.bincount(labels.ravel(), weights=smooth.ravel(), minlength=count)[1:]
    boxes = np.column_stack([stats[1:, 0], stats[1:, 1], stats[1:, 0] + stats[1:, 2], stats[1:, 1] + stats[1:, 3]])
    large = stats[1:, cv2.CC_STAT_AREA] >= _LEAST_AREA_PX
    which = 1 + np.flatnonzero(large)
    return Pieces(
        boxes[large].astype(np.float64), np.asarray(total[large], np.float64), np.asarray(labels, np.int32), which
    )


def find_light(light: Light, pieces: Pieces | None = None) -> Box | None:
    """The box of the brightest connected light and of what lies near it; dark as well as light. None: empty sky.

    What is as small as a star belongs to the object only if it almost touches it. ``pieces``: those of this light.
    """
    all_pieces = pieces or pieces_of(light)
    boxes = all_pieces.boxes
    if not len(boxes):
        return None
    whole = boxes[np.argmax(all_pieces.total)]
    small = all_pieces.extent <= _STAR_PX
    large = boxes[~small]
    near = np.zeros(len(large), dtype=bool)
    while (more := _near(large, whole, _NEAR) & ~near).any():
        near |= more
        whole = _around(whole, large[more])
    whole = _around(whole, boxes[small & _near(boxes, whole, _NEAR_STAR)])  # from a star no further: it is no boom
    x, y = light.origin
    return Box(*(float(v) for v in whole + np.array([x, y, x, y])))


def wider(light: Light, pieces: Pieces, box: Box) -> Box:
    """The box with the pieces nearest to it, until it holds almost all light: of a body that is mostly in shadow a few
    specks are all that is seen, and the brightest of them is as good as any other to begin with.
    """
    x, y = light.origin
    whole = np.array([box.left - x, box.top - y, box.right - x, box.bottom - y])
    enough = _ALMOST_ALL * pieces.total.sum()
    while True:
        beyond = _beyond(pieces.boxes, whole)
        if pieces.total[~beyond].sum() >= enough:
            return Box(*(float(v) for v in whole + np.array([x, y, x, y])))
        whole = _around(whole, pieces.boxes[[np.argmin(np.where(beyond, _gaps(pieces.boxes, whole), np.inf))]])


def _near(boxes: NDArray[np.float64], whole: NDArray[np.float64], share: float) -> NDArray[np.bool_]:
    """Which boxes are within a share of the diagonal of one."""
    return np.asarray(_gaps(boxes, whole) <= share * float(np.hypot(whole[2] - whole[0], whole[3] - whole[1])))


def _beyond(boxes: NDArray[np.float64], whole: NDArray[np.float64]) -> NDArray[np.bool_]:
    """(N,) which boxes are not within one."""
    return np.asarray(np.any(boxes[:, :2] < whole[:2], axis=1) | np.any(boxes[:, 2:] > whole[2:], axis=1))


def _gaps(boxes: NDArray[np.float64], whole: NDArray[np.float64]) -> NDArray[np.float64]:
    """(N,) px between boxes and one."""
    gap = np.maximum(np.maximum(boxes[:, :2] - whole[2:], whole[:2] - boxes[:, 2:]), 0.0)
    return np.asarray(np.linalg.norm(gap, axis=1))


def _around(whole: NDArray[np.float64], boxes: NDArray[np.float64]) -> NDArray[np.float64]:
    """The box of all of them."""
    every = np.concatenate([whole[None], boxes])
    return np.concatenate([every[:, :2].min(0), every[:, 2:].max(0)])


def square_around(centre: tuple[float, float], span_px: float, wanted: float) -> Square:
    """The square around ``centre`` that holds a body spanning ``span_px``, in which it spans about ``wanted``."""
    binning = span_px / wanted if span_px > _COARSER * wanted else 1.0
    margin = max(_MARGIN * span_px, _LEAST_MARGIN_PX * binning)
    side = int(np.ceil((span_px + 2 * margin) / binning))
    side += -side % 16  # rows of whole lanes
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
    image = np.where(inside, light.image[index], 0.0).astype(np.float32)
    censored = (light.censored[index] | ~inside).astype(np.float32)
    stars = np.zeros((1, 1), np.uint8) if light.stars is None else np.where(inside, light.stars[index], 0)
    return Patch(
        image=np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), np.float32),
        sigma=light.sigma / binning,
        photon=light.photon / binning**2,
        hidden=light.hidden,
        censored=cv2.resize(censored, size, interpolation=cv2.INTER_AREA) > 0,
        stars=np.asarray(cv2.resize(np.asarray(stars, np.uint8), size, interpolation=cv2.INTER_NEAREST), np.uint8),
        origin=(float(square.first[0]), float(square.first[1])),
        binning=binning,
    )

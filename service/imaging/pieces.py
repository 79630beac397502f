"""Connected light of a frame: which of it is the object's, and which may be a star's (docs/model.md, 2 and 4)."""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from service.imaging.patch import OWN, Light
from service.imaging.sky import STAR_PX

DETECTION_SIGMAS = 5.0  # prior: one pixel in a million of empty sky
"""Light counts as detected from here on, after a smoothing by one pixel: one false pixel in a few million."""
_SMOOTH_PX = 1.0  # prior: light is at least so smooth
_SMOOTHED_SIGMA = 1.0 / (2.0 * np.sqrt(np.pi) * _SMOOTH_PX)  # exact: of white noise of unit variance after it
_LEAST_AREA_PX = 9  # prior: what is smaller has no shape
# prior: components nearer than this share of the object's diagonal belong to it: booms and panels half in shadow
_NEAR = 0.35
# prior: share of the diagonal within which even something so small belongs to the object
_NEAR_STAR = 0.06
_ALMOST_ALL = 0.95  # numerical: of a frame's light: what a search's wider sight holds
_MOST_STARS = 31  # numerical: that are told apart


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

    def stars_of(self, light: Light, box: Box | None, known_px: float = 0.0) -> Light:
        """The light with what may be stars told apart: all that is as small and lies outside of the object's box.

        ``known_px``: what the object's light spanned until now. Where that is more than a star and nothing larger than
        one shows, what is in the box may be a star's too, if the object is absent.
        """
        if box is None:
            return light
        lonely, (x, y) = self.extent.max(initial=0) <= STAR_PX < known_px, light.origin
        outside = _beyond(self.boxes, np.array((box.left - x, box.top - y, box.right - x, box.bottom - y)))
        order = np.argsort(-self.total)
        order = order[(outside[order] | lonely) & (self.extent[order] <= STAR_PX)][:_MOST_STARS]
        if not len(order):
            return light
        named = np.zeros(int(self.labels.max()) + 1, np.uint8)
        named[self.numbers[order]] = 1 + np.arange(len(order)) + np.where(outside[order], 0, OWN)
        return replace(light, stars=named[self.labels])


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
    small = all_pieces.extent <= STAR_PX
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

"""A frame's light as the filter is given it (``service.inference.filters.mixture.LitFrame``)."""

from __future__ import annotations

from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from service.imaging.patch import LANES, Light, Patch, cut, light_of, square_around
from service.imaging.pieces import Box, Pieces, find_light, pieces_of, wider
from service.imaging.psf import estimate_psf_sigma
from service.imaging.sky import Sky
from service.inference.filters.status import told_existence
from service.inference.model import existence
from service.inference.model.drawing import Lens
from service.inference.model.prior import CORE_PX
from service.inference.model.stages import Sight
from service.inference.state import FilterState

Region = tuple[slice, slice]  # rows and columns of a frame
_AROUND = 2.0  # radii of the body about where it is expected
_MARGIN_PX = 32
_RIM_PX = 3.0  # of a bright body's light in usual seeing
_LEAST_SPAN_PX = 8.0  # of light that is cut out
_WORTH = 0.5  # of the frame's pixels: a region that is larger saves nothing
"""Numerical: where the object is not found in its region, the whole frame is looked at."""


def region_of(
    state: FilterState | None, time_s: float, radius: float, shape: tuple[int, int], mesh_error: float = 0.0
) -> Region | None:
    """Where the heaviest mode of a track should be in a frame of (H, W) pixels; None: anywhere, as while it is doubted.

    ``radius`` of the body, model units; ``mesh_error``: ``PriorParams``.
    """
    held = None if state is None else state.mixture
    if state is None or held is None or told_existence(held, mesh_error)[existence.FITS] < 0.5:
        return None
    lead, dt_s = int(np.argmax(held.log_weights)), max(time_s - state.time_s, 0.0)
    centre = held.poses.position[lead] + held.rates[lead, 3:5] * dt_s
    half = _AROUND * radius * float(np.exp(held.poses.log_scale[lead])) + _MARGIN_PX
    low = np.maximum(np.floor(centre - half), 0).astype(int)
    high = np.minimum(np.ceil(centre + half), shape[::-1]).astype(int)
    if (high <= low).any() or np.prod(high - low) > _WORTH * np.prod(shape):
        return None
    return slice(int(low[1]), int(high[1])), slice(int(low[0]), int(high[0]))


def known_span(state: FilterState | None) -> float:
    """Frame px that the object's light spanned until now, at the least; 0: it has not been seen.

    A patch's side is a multiple of 16 px, so what it was cut for may have been that much smaller.
    """
    return 0.0 if state is None or state.mixture is None else max(state.mixture.span_px - LANES, 0.0)


class LightOfFrame:
    """One frame above its sky; ``region``: where the object is expected; ``known_px`` as ``Pieces.stars_of``."""

    def __init__(
        self,
        image: NDArray[np.generic],
        sky: Sky,
        bits: int,
        psf_px: float | None,
        region: Region | None = None,
        lens: Lens | None = None,
        known_px: float = 0.0,
    ) -> None:
        self._image, self._sky, self._bits = image, sky, bits
        self._psf_px, self._region, self._lens, self._known_px = psf_px, region, lens, known_px

    @cached_property
    def sight(self) -> Sight | None:
        """Of the brightest light and of what lies near it."""
        return self._sight(self._box)

    @cached_property
    def wide(self) -> Sight | None:
        """The same with what lies further off, until almost all light is in it."""
        return None if self._box is None else self._sight(wider(self._light, self._pieces, self._box))

    @property
    def span_px(self) -> float | None:
        """Longer side of the object's light without its rim, which the point spread adds; None: empty sky."""
        return None if self._box is None else max(self._box.side - 2 * _RIM_PX, 1.0)

    def around(self, centre: NDArray[np.float64], reach_px: float, span_px: float, psf_px: float) -> Sight:
        """The light within ``reach_px`` of a place; where there is none, a square of ``span_px`` about it."""
        box = self._box
        near = box is not None and float(np.hypot(*(np.array(box.centre) - centre))) <= reach_px
        if box is not None and near and box.side <= 2 * reach_px:
            return self._seen(box.centre, max(box.side, _LEAST_SPAN_PX), psf_px)
        return self._seen((float(centre[0]), float(centre[1])), span_px, psf_px)

    @cached_property
    def _whole(self) -> Light:
        return light_of(self._image, self._sky, self._bits)

    @cached_property
    def _found(self) -> tuple[Light, Pieces, Box | None]:
        """Of the region, if the object's light ends within it; else of the whole frame."""
        if self._region is not None:
            light = light_of(self._image, self._sky, self._bits, self._region)
            pieces = pieces_of(light)
            box = find_light(light, pieces)
            if box is not None and self._ends_within(box):
                return pieces.stars_of(light, box, self._known_px), pieces, box
        pieces = pieces_of(self._whole)
        box = find_light(self._whole, pieces)
        return pieces.stars_of(self._whole, box, self._known_px), pieces, box

    @cached_property
    def _all(self) -> Light:
        """Of the whole frame, wherever the object was found."""
        if self._light.image is self._whole.image:
            return self._light
        return pieces_of(self._whole).stars_of(self._whole, self._box, self._known_px)

    @property
    def _light(self) -> Light:
        return self._found[0]

    @property
    def _pieces(self) -> Pieces:
        return self._found[1]

    @property
    def _box(self) -> Box | None:
        return self._found[2]

    def _ends_within(self, box: Box) -> bool:
        assert self._region is not None
        rows, columns = self._region
        height, width = self._image.shape[:2]
        beyond = (
            (box.left <= columns.start and columns.start > 0)
            or (box.top <= rows.start and rows.start > 0)
            or (box.right >= columns.stop and columns.stop < width)
            or (box.bottom >= rows.stop and rows.stop < height)
        )
        return not beyond

    @cached_property
    def _psf(self) -> float:
        if self._psf_px is not None:
            return self._psf_px
        return estimate_psf_sigma(np.asarray(np.abs(self._light.image) / self._light.sigma, np.float32)) or CORE_PX

    def _sight(self, box: Box | None) -> Sight | None:
        return None if box is None else self._seen(box.centre, box.side, self._psf)

    def _seen(self, centre: tuple[float, float], span_px: float, psf_px: float) -> Sight:
        def patch(centre: tuple[float, float], span: float, wanted: float) -> Patch:
            near = self._light.covers(square_around(centre, span, wanted))
            light = self._light if near else self._all
            return cut(light, centre, span, wanted)

        pieces = self._pieces.boxes + np.tile(self._light.origin, 2)
        return Sight(patch, centre, span_px, psf_px, self._lens, pieces)

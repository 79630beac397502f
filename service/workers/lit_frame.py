"""A frame's light as the filter is given it (``service.inference.filters.mixture.LitFrame``)."""

from __future__ import annotations

from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from service.imaging.background import Sky
from service.imaging.patch import Box, cut, find_light, light_of
from service.imaging.psf import estimate_psf_sigma
from service.inference.model.prior import CORE_PX
from service.inference.model.stages import Sight


class LightOfFrame:
    """One frame above its sky."""

    def __init__(self, image: NDArray[np.generic], sky: Sky, bits: int, psf_px: float | None) -> None:
        self._light = light_of(image, sky, bits)
        self._psf_px = psf_px

    @cached_property
    def sight(self) -> Sight | None:
        """Of the brightest light and of what lies near it."""
        return self._sight(self._box)

    @cached_property
    def wide(self) -> Sight | None:
        """The same with all specks."""
        return self._sight(find_light(self._light, specks=True))

    def around(self, centre: NDArray[np.float64], reach_px: float, span_px: float, psf_px: float) -> Sight:
        """The light within ``reach_px`` of a place; where there is none, a square of ``span_px`` about it."""
        box = self._box
        near = box is not None and float(np.hypot(*(np.array(box.centre) - centre))) <= reach_px
        if box is not None and near and box.side <= 2 * reach_px:
            return self._seen(box.centre, max(box.side, 8.0), psf_px)
        return self._seen((float(centre[0]), float(centre[1])), span_px, psf_px)

    @cached_property
    def _box(self) -> Box | None:
        return find_light(self._light)

    @cached_property
    def _psf(self) -> float:
        if self._psf_px is not None:
            return self._psf_px
        return estimate_psf_sigma(np.asarray(np.abs(self._light.image) / self._light.sigma, np.float32)) or CORE_PX

    def _sight(self, box: Box | None) -> Sight | None:
        return None if box is None else self._seen(box.centre, box.side, self._psf)

    def _seen(self, centre: tuple[float, float], span_px: float, psf_px: float) -> Sight:
        return Sight(lambda span, wanted: cut(self._light, centre, span, wanted), span_px, psf_px)

"""A session's window on its frames: a region of interest, and pixels averaged in squares.

The filter works on the window; everything reported is in pixels of the whole frame.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from service.errors import ConfigError
from service.imaging.frame import Frame

Roi = tuple[int, int, int, int]  # x, y, width, height in pixels of the whole frame


@dataclass(frozen=True)
class Window:
    """Which pixels of a frame are used. Width and height are whole multiples of ``binning``."""

    x: int
    y: int
    width: int
    height: int
    binning: int

    @property
    def size(self) -> tuple[int, int]:
        """Width and height of the image that is cut, in binned pixels."""
        return self.width // self.binning, self.height // self.binning

    def cut(self, frame: Frame) -> Frame:
        """The window of a frame. Averages are rounded to the frame's own depth."""
        image: NDArray[Any] = frame.image[self.y : self.y + self.height, self.x : self.x + self.width]
        if self.binning > 1:
            image = np.rint(self._squares(image).mean(axis=(1, 3))).astype(frame.image.dtype)
        return replace(frame, image=np.ascontiguousarray(image))

    def cut_mask(self, mask: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """The window of a mask (H, W): a binned pixel counts where all of its pixels do."""
        inside = mask[self.y : self.y + self.height, self.x : self.x + self.width]
        return np.asarray(self._squares(inside).all(axis=(1, 3)))

    def _squares(self, image: NDArray[Any]) -> NDArray[Any]:
        b = self.binning
        return image.reshape(image.shape[0] // b, b, image.shape[1] // b, b, *image.shape[2:])


def window_of(width: int, height: int, roi: Roi | None, binning: int) -> Window:
    """The window on frames of a size; rows and columns that fill no square are left off at the right and below.

    Raises ``ConfigError`` for a region that reaches outside of the frame, or is smaller than one square.
    """
    x, y, w, h = roi or (0, 0, width, height)
    if x + w > width or y + h > height:
        raise ConfigError(
            f"the region {w} x {h} at {x}, {y} reaches outside of the image ({width} x {height})", field="camera.roi"
        )
    window = Window(x, y, w - w % binning, h - h % binning, binning)
    if min(window.size) < 1:
        raise ConfigError("the image is smaller than one binned pixel", field="camera.binning")
    return window

"""The paper's Table 1 for any pass: frame, best silhouette and blue overlay, at a few frames."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from service.imaging.overlay import RGB, Mask, draw_overlay, draw_silhouette, for_display

# shown: in the paper
SHOWN_FRAMES = (1, 5, 10, 100)
"""Counted from 1, as in the paper; the last frame stands in for those past the end."""

_COLUMNS = ("frame", "best silhouette", "overlay")
# shown: the sheet's looks
_LEAST_WIDTH_PX = 256
_MARGIN_PX, _HEADER_PX, _LABEL_PX = 6, 42, 190
_FONT, _FONT_SIZE, _LINE_PX = cv2.FONT_HERSHEY_SIMPLEX, 0.45, 17
_INK, _PAPER = (230, 230, 230), 24


@dataclass(frozen=True)
class SheetRow:
    """One frame and what was found in it."""

    label: str  # may have several lines
    image: NDArray[np.uint8] | NDArray[np.uint16]  # (H, W) or (H, W, 3)
    mask: Mask  # (H, W) the best silhouette


def shown_indices(n_frames: int) -> list[int]:
    """Which frames (from 0) of a pass of ``n_frames`` a sheet shows."""
    return sorted({min(number, n_frames) - 1 for number in SHOWN_FRAMES}) if n_frames else []


def contact_sheet(title: str, rows: Sequence[SheetRow]) -> RGB:
    """(H, W, 3) uint8 RGB: one line of three pictures per row, labelled. The frames must be of one size."""
    strips = [_strip(row) for row in rows]
    width = max((strip.shape[1] for strip in strips), default=_LABEL_PX)
    header = np.full((_HEADER_PX, width, 3), _PAPER, dtype=np.uint8)
    _write(header, title, _MARGIN_PX, _LINE_PX)
    if strips:
        step = (width - _LABEL_PX) // len(_COLUMNS)
        for k, name in enumerate(_COLUMNS):
            _write(header, name, _LABEL_PX + k * step, 2 * _LINE_PX)
    return np.vstack([header, *strips])


def _strip(row: SheetRow) -> RGB:
    pictures = (for_display(row.image), draw_silhouette(row.mask), draw_overlay(row.image, row.mask))
    factor = max(1, -(-_LEAST_WIDTH_PX // row.mask.shape[1]))
    height, width = (side * factor for side in row.mask.shape)
    line_count = row.label.count("\n") + 1
    tall = max(height, line_count * _LINE_PX) + _MARGIN_PX
    out = np.full((tall, _LABEL_PX + len(pictures) * (width + _MARGIN_PX), 3), _PAPER, dtype=np.uint8)
    for k, line in enumerate(row.label.split("\n")):
        _write(out, line, _MARGIN_PX, (k + 1) * _LINE_PX)
    for k, picture in enumerate(pictures):
        x = _LABEL_PX + k * (width + _MARGIN_PX)
        enlarged = picture.repeat(factor, axis=0).repeat(factor, axis=1)
        out[:height, x : x + width] = enlarged
    return out


def _write(picture: RGB, text: str, x: int, y: int) -> None:
    cv2.putText(picture, text, (x, y), _FONT, _FONT_SIZE, _INK, 1, cv2.LINE_AA)

"""From counts back to light, where a camera or a program has stretched them (``camera.transfer``)."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from service.imaging.frame import Frame

Transfer = Literal["linear", "srgb"] | float
_MOST = 65_535  # format: of 16 bits
_KNEE, _SLOPE, _OFFSET, _POWER = 0.04045, 12.92, 0.055, 2.4  # format: of sRGB, IEC 61966-2-1


def linear(frame: Frame, transfer: Transfer) -> Frame:
    """The frame in 16 bits that are proportional to light; full scale stays full scale.

    ``transfer``: a power p means counts as light to the power p, both as shares of full scale.
    """
    if transfer in ("linear", 1.0):
        return frame
    return replace(frame, image=_table(transfer, frame.bits)[frame.image], bits=16)


@lru_cache(maxsize=8)
def _table(transfer: Transfer, bits: int) -> NDArray[np.uint16]:
    share = np.arange(1 << bits) / ((1 << bits) - 1)
    if transfer == "srgb":
        light = np.where(share <= _KNEE, share / _SLOPE, ((share + _OFFSET) / (1 + _OFFSET)) ** _POWER)
    else:
        light = share ** (1.0 / float(transfer))
    table: NDArray[np.uint16] = np.rint(light * _MOST).astype(np.uint16)
    table.flags.writeable = False
    return table

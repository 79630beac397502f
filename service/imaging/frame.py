"""A decoded image, and the rules by which other number formats become 8 or 16 bits."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from service.imaging.facts import NOTHING, FrameFacts
from service.imaging.headers import broken

Pixels = NDArray[np.uint8] | NDArray[np.uint16]
_MOST = 65_535  # format: of 16 bits


@dataclass(frozen=True)
class Frame:
    """A decoded image: (H, W) grey or (H, W, 3) RGB, uint8 or uint16."""

    image: Pixels
    bits: int  # 8 or 16
    channels: int  # 1 or 3
    facts: FrameFacts = NOTHING


def as_frame(image: NDArray[Any], facts: FrameFacts = NOTHING) -> Frame:
    """A frame of (H, W) or (H, W, 3) numbers of any kind.

    8 and 16 bits unsigned stay as they are. Everything else becomes 16 bits: integers and floats are counts, rounded;
    negative ones and NaN become 0; floats none of which exceeds 1 are shares of full scale. Raises ``ImageError`` for
    counts that 16 bits cannot hold, since cutting them off would flatten the object, and for floats without a number.
    """
    if image.ndim == 3 and image.shape[2] == 1:
        image = image[:, :, 0]
    pixels: Pixels = np.ascontiguousarray(_sixteen_bits(image), dtype=None)
    return Frame(pixels, pixels.dtype.itemsize * 8, 1 if pixels.ndim == 2 else 3, facts)


def _sixteen_bits(image: NDArray[Any]) -> NDArray[Any]:
    if image.dtype.kind == "u" and image.dtype.itemsize <= 2:
        return image.astype(image.dtype.newbyteorder("="), copy=False)
    if image.dtype.kind not in "biuf":
        raise broken(f"pixels of type {image.dtype} are no numbers")
    if image.dtype.kind == "f" and not np.isfinite(image).any():
        raise broken("no pixel is a number: all are NaN or infinite")
    values = np.nan_to_num(image.astype(np.float64), nan=0.0, posinf=np.inf, neginf=0.0)
    most = float(values.max(initial=0.0))
    if image.dtype.kind == "f" and most <= 1.0:
        values, most = values * _MOST, most * _MOST
    if most > _MOST + 0.5:
        raise broken(f"pixels reach {most:g}; 16 bits hold {_MOST}")
    return np.clip(np.rint(values), 0, _MOST).astype(np.uint16)

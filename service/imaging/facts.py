"""What a file says about its frames beside their pixels."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import datetime
from typing import Literal


@dataclass(frozen=True)
class FrameFacts:
    """Time and pointing of one frame; None is unknown."""

    time: datetime | None = None  # aware; middle of the exposure
    ra_deg: float | None = None  # of the image's centre
    dec_deg: float | None = None
    position_angle_deg: float | None = None  # of the image's up direction, from north through east
    mirrored: bool | None = None
    equinox: Literal["J2000", "date"] | None = None
    pixel_scale_deg: float | None = None


NOTHING = FrameFacts()

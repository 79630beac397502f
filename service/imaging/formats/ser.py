"""SER video, version 3: a header of 178 bytes, raw frames, and a trailer of time stamps that may be missing.

The header's field "LittleEndian" is set the wrong way round by most programs that write 16 bits, so ``auto`` asks the
pixels: in the right order neighbours resemble each other, and nothing exceeds the stated depth.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from typing import Literal

import cv2
import numpy as np
from numpy.typing import NDArray

from service.imaging.facts import FrameFacts
from service.imaging.frame import Frame, as_frame
from service.imaging.headers import broken
from service.imaging.limits import ImageLimits

ByteOrder = Literal["auto", "little", "big"]

_HEADER = struct.Struct("<14s7i40s40s40s2q")
_SIGNATURE = b"LUCAM-RECORDER"
# format: SER, version 3
_MONO, _RGB, _BGR = 0, 100, 101
_BAYER = {
    8: cv2.COLOR_BayerRGGB2RGB,
    9: cv2.COLOR_BayerGRBG2RGB,
    10: cv2.COLOR_BayerGBRG2RGB,
    11: cv2.COLOR_BayerBGGR2RGB,
}
_YEAR_ONE = datetime(1, 1, 1, tzinfo=UTC)
_TICKS_PER_MICROSECOND = 10
_MOST_TICKS = 3_155_378_976_000_000_000  # the year 10,000
_LOOKED_AT = 1 << 16  # numerical: pixels that decide the byte order


@dataclass(frozen=True)
class _Header:
    colour: int
    width: int
    height: int
    depth: int
    frames: int

    @property
    def planes(self) -> int:
        return 3 if self.colour in (_RGB, _BGR) else 1

    @property
    def frame_bytes(self) -> int:
        return self.width * self.height * self.planes * (1 if self.depth <= 8 else 2)


def read_ser(body: bytes, limits: ImageLimits, byte_order: ByteOrder = "auto") -> Sequence[Frame]:
    """Every frame, with its time where the trailer has one. Raises ``ImageError``, ``TooLargeError``."""
    header = _read_header(body, limits)
    end = _HEADER.size + header.frames * header.frame_bytes
    raw = np.frombuffer(body, np.uint8 if header.depth <= 8 else "<u2", (end - _HEADER.size) * 8 // _bits(header), 178)
    if header.depth > 8 and (byte_order == "big" or (byte_order == "auto" and _is_swapped(raw, header))):
        raw = raw.byteswap()
    stack = raw.reshape(header.frames, header.height, header.width, header.planes)
    times = read_ser_times(body, limits)
    return [
        as_frame(_colours(image, header.colour), FrameFacts(time)) for image, time in zip(stack, times, strict=True)
    ]


def read_ser_times(body: bytes, limits: ImageLimits) -> list[datetime | None]:
    """UTC of every frame out of the trailer; None where it is missing, 0 or no date. Raises as ``read_ser`` does."""
    header = _read_header(body, limits)
    start = _HEADER.size + header.frames * header.frame_bytes
    if start + 8 * header.frames > len(body):
        return [None] * header.frames
    return [_time(ticks) for ticks in struct.unpack_from(f"<{header.frames}q", body, start)]


def _read_header(body: bytes, limits: ImageLimits) -> _Header:
    if len(body) < _HEADER.size:
        raise broken("SER: the file is shorter than its header")
    _, _, colour, _, width, height, depth, frames, *_ = _HEADER.unpack_from(body)
    header = _Header(colour, width, height, depth, frames)
    if not body.startswith(_SIGNATURE):
        raise broken("the media type says SER, but the body does not begin with a SER signature")
    if colour not in (_MONO, _RGB, _BGR, *_BAYER) or not 1 <= depth <= 16 or min(width, height, frames) < 0:
        raise broken(f"SER: colour {colour} with {depth} bits in {frames} frames of {width} x {height} is unknown")
    limits.require_size(frames, width, height)
    if _HEADER.size + frames * header.frame_bytes > len(body):
        raise broken(f"SER: the file is cut short ({frames} frames are stated)")
    return header


def _bits(header: _Header) -> int:
    return 8 if header.depth <= 8 else 16


def _is_swapped(raw: NDArray[np.uint16], header: _Header) -> bool:
    """Whether the pixels make more sense with their bytes exchanged."""
    row = header.width * header.planes
    middle = raw[(len(raw) // 2 // row) * row :][: max(_LOOKED_AT // row, 1) * row]
    swapped = middle.byteswap()
    fits = [bool(np.all(values < 1 << header.depth)) for values in (middle, swapped)]
    if fits[0] != fits[1]:
        return fits[1]
    rough = [np.abs(np.diff(values.astype(np.int32).reshape(-1, row))).sum() for values in (middle, swapped)]
    return bool(rough[1] < rough[0])


def _colours(image: NDArray[np.generic], colour: int) -> NDArray[np.generic]:
    if colour in _BAYER:
        return np.asarray(cv2.cvtColor(np.ascontiguousarray(image[:, :, 0]), _BAYER[colour]))
    return image[:, :, ::-1] if colour == _BGR else image


def _time(ticks: int) -> datetime | None:
    """.NET ticks of 100 ns since the year 1."""
    return None if not 0 < ticks < _MOST_TICKS else _YEAR_ONE + timedelta(microseconds=ticks // _TICKS_PER_MICROSECOND)

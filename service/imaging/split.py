"""A file of several frames as files of one frame each."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import cv2

from service.imaging.decode import FITS, SER, ByteOrder, decode_frames
from service.imaging.facts import FrameFacts
from service.imaging.formats.npy import count_npy_frames
from service.imaging.formats.ser import read_ser_times
from service.imaging.frame import Frame
from service.imaging.headers import broken, media_kind, read_header
from service.imaging.limits import DEFAULT_LIMITS, ImageLimits

PNG = "image/png"
_FAST = (cv2.IMWRITE_PNG_COMPRESSION, 1)  # numerical: least compression


@dataclass(frozen=True)
class SplitFrame:
    """One frame as PNG, with what the file says of it."""

    body: bytes
    facts: FrameFacts


def frame_count(body: bytes, media_type: str, limits: ImageLimits = DEFAULT_LIMITS) -> int | None:
    """How many frames a file holds by its header; None for a video, which has to be decoded to know.

    Raises ``ImageError`` for a damaged header. Of media types that are not supported it says 1: decoding refuses them.
    """
    kind = media_kind(media_type)
    if kind in FITS:
        from service.imaging.formats.fits import count_fits_frames  # astropy, when it is needed

        return count_fits_frames(body, limits)
    if kind in SER:
        return len(read_ser_times(body, limits))
    if kind == "application/x-npy":
        return count_npy_frames(body)
    if kind == "image/tiff":
        return read_header(body, media_type, limits).frames
    return None if kind.startswith("video/") else 1


def split_frames(
    body: bytes, media_type: str, *, limits: ImageLimits = DEFAULT_LIMITS, ser_byte_order: ByteOrder = "auto"
) -> tuple[SplitFrame, ...]:
    """Every frame, losslessly. Raises as ``decode_frames`` does."""
    return tuple(_encoded(decode_frames(body, media_type, limits=limits, ser_byte_order=ser_byte_order)))


def _encoded(frames: tuple[Frame, ...]) -> Iterator[SplitFrame]:
    for frame in frames:
        image = frame.image if frame.channels == 1 else frame.image[:, :, ::-1]  # OpenCV writes blue first
        written, data = cv2.imencode(".png", image, _FAST)
        if not written:
            raise broken("a frame cannot be kept as PNG")
        yield SplitFrame(data.tobytes(), frame.facts)

"""Bytes of an image file -> pixels, with size limits checked in the header before anything is decoded."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from service.errors import TooLargeError
from service.imaging.facts import NOTHING, FrameFacts
from service.imaging.headers import ImageHeader, broken, read_header

MAX_PIXELS = 1 << 26
"""Default limit of the pixels in one body, all frames together."""

Pixels = NDArray[np.uint8] | NDArray[np.uint16]


@dataclass(frozen=True)
class Frame:
    """A decoded image: (H, W) grey or (H, W, 3) RGB, uint8 or uint16."""

    image: Pixels
    bits: int  # 8 or 16
    channels: int  # 1 or 3


def decode_frame(body: bytes, media_type: str, *, max_pixels: int = MAX_PIXELS) -> Frame:
    """Decode a file that holds one image. Alpha is dropped, 16 bits are kept.

    Raises ``UnsupportedMediaTypeError``, ``TooLargeError``, or ``ImageError`` for a file that is broken, cut
    short, or holds several frames.
    """
    header = _checked_header(body, media_type, max_pixels)
    if header.frames != 1:
        raise broken(f"the file holds {header.frames} frames where one is expected")
    return _decode(body, header)


def decode_frames(body: bytes, media_type: str, *, max_pixels: int = MAX_PIXELS) -> tuple[Frame, ...]:
    """Decode every frame of a file (TIFF can hold several). ``max_pixels`` counts all of them together.

    Raises as ``decode_frame`` does.
    """
    header = _checked_header(body, media_type, max_pixels)
    if header.frames == 1:
        return (_decode(body, header),)
    found, images = cv2.imdecodemulti(np.frombuffer(body, np.uint8), cv2.IMREAD_UNCHANGED)
    if not found or len(images) != header.frames:
        raise broken(f"only {len(images)} of {header.frames} frames can be decoded")
    return tuple(_frame(image, header) for image in images)


def _checked_header(body: bytes, media_type: str, max_pixels: int) -> ImageHeader:
    header = read_header(body, media_type)
    pixels = header.width * header.height * header.frames
    if pixels > max_pixels:
        raise TooLargeError(
            f"{header.frames} x {header.width} x {header.height} pixels exceed the limit of {max_pixels}",
            field="body",
            limit=max_pixels,
            found=pixels,
        )
    return header


def _decode(body: bytes, header: ImageHeader) -> Frame:
    try:
        image = cv2.imdecode(np.frombuffer(body, np.uint8), cv2.IMREAD_UNCHANGED)
    except cv2.error as error:
        raise broken(f"the image cannot be decoded: {error}") from error
    if image is None:
        raise broken("the image cannot be decoded: its data are damaged")
    return _frame(image, header)


def _frame(image: NDArray[np.generic], header: ImageHeader) -> Frame:
    expected: Sequence[int] = (header.height, header.width)
    if image.shape[:2] != tuple(expected) or image.dtype not in (np.uint8, np.uint16):
        raise broken(f"decoded to {image.shape} {image.dtype}, the header says {tuple(expected)}, {header.bits} bits")
    if image.ndim == 3:
        # OpenCV's order is blue, green, red, alpha; grey with alpha comes back as four equal planes.
        image = image[:, :, 0] if header.channels == 1 or image.shape[2] == 1 else image[:, :, 2::-1]
    pixels: Pixels = np.ascontiguousarray(image)
    return Frame(pixels, pixels.dtype.itemsize * 8, 1 if pixels.ndim == 2 else 3)


def read_facts(body: bytes, media_type: str) -> FrameFacts:
    """Time and pointing that a file of one frame states; nothing where its format has no place for them."""
    return NOTHING

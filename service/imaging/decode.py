"""Bytes of an image file -> pixels, with size limits checked in the header before anything is decoded.

One table says which media type is read by what. The observatory's formats are imported when the first such file
comes: astropy takes a second.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from service.errors import UnsupportedMediaTypeError
from service.imaging.facts import NOTHING, FrameFacts
from service.imaging.formats.imagebytes import read_imagebytes
from service.imaging.formats.npy import read_npy
from service.imaging.formats.ser import ByteOrder, read_ser, read_ser_times
from service.imaging.formats.video import read_video
from service.imaging.frame import Frame, Pixels
from service.imaging.headers import MEDIA_TYPES, ImageHeader, broken, media_kind, read_header
from service.imaging.limits import DEFAULT_LIMITS, ImageLimits

__all__ = ["ByteOrder", "Frame", "ImageLimits", "Pixels", "decode_frame", "decode_frames", "read_facts"]

FITS = ("image/fits", "application/fits")
SER = ("video/x-ser", "application/x-ser")


def decode_frame(
    body: bytes, media_type: str, *, limits: ImageLimits = DEFAULT_LIMITS, ser_byte_order: ByteOrder = "auto"
) -> Frame:
    """Decode a file that holds one image. Alpha is dropped, 16 bits are kept.

    Raises ``UnsupportedMediaTypeError``, ``TooLargeError``, or ``ImageError`` for a file that is broken, cut
    short, or holds several frames.
    """
    if media_kind(media_type) in MEDIA_TYPES:
        header = _checked_header(body, media_type, limits)
        _require_one(header.frames)
        return _decode(body, header)
    frames = decode_frames(body, media_type, limits=limits, ser_byte_order=ser_byte_order)
    _require_one(len(frames))
    return frames[0]


def decode_frames(
    body: bytes, media_type: str, *, limits: ImageLimits = DEFAULT_LIMITS, ser_byte_order: ByteOrder = "auto"
) -> tuple[Frame, ...]:
    """Decode every frame of a file.

    Raises as ``decode_frame`` does.
    """
    kind = media_kind(media_type)
    if kind in SER:
        return tuple(read_ser(_some(body), limits, ser_byte_order))
    reader = _READERS.get("video/*" if kind.startswith("video/") else kind)
    if reader is not None:
        return tuple(reader(_some(body), limits))
    header = _checked_header(body, media_type, limits)
    if header.frames == 1:
        return (_decode(body, header),)
    try:
        found, images = cv2.imdecodemulti(np.frombuffer(body, np.uint8), cv2.IMREAD_UNCHANGED)
    except cv2.error as error:
        raise broken(f"the frames cannot be decoded: {error}") from error
    if not found or len(images) != header.frames:
        raise broken(f"only {len(images)} of {header.frames} frames can be decoded")
    return tuple(_frame(image, header) for image in images)


def read_facts(body: bytes, media_type: str, *, limits: ImageLimits = DEFAULT_LIMITS) -> FrameFacts:
    """Time and pointing that a file states of its first frame, without decoding pixels.

    Nothing where its format has no place for them. Raises as ``decode_frame`` does.
    """
    kind = media_kind(media_type)
    if kind in FITS:
        from service.imaging.formats.fits import read_fits_facts

        return read_fits_facts(_some(body), limits)
    if kind in SER:
        times = read_ser_times(_some(body), limits)
        return FrameFacts(times[0]) if times else NOTHING
    return NOTHING


def _read_fits(body: bytes, limits: ImageLimits) -> Sequence[Frame]:
    from service.imaging.formats.fits import read_fits

    return read_fits(body, limits)


_READERS: Mapping[str, Callable[[bytes, ImageLimits], Sequence[Frame]]] = {
    **dict.fromkeys(FITS, _read_fits),
    "application/x-npy": read_npy,
    "application/imagebytes": read_imagebytes,
    "video/*": read_video,
}
SUPPORTED = tuple(sorted((*MEDIA_TYPES, *_READERS, *SER)))


def _some(body: bytes) -> bytes:
    if not body:
        raise broken("the image is empty")
    return body


def _require_one(frames: int) -> None:
    if frames != 1:
        raise broken(f"the file holds {frames} frames where one is expected")


def _checked_header(body: bytes, media_type: str, limits: ImageLimits) -> ImageHeader:
    if media_kind(media_type) not in MEDIA_TYPES:
        raise UnsupportedMediaTypeError(
            f"media type {media_type!r} is not one of {', '.join(SUPPORTED)}",
            field="header:Content-Type",
            supported=list(SUPPORTED),
        )
    header = read_header(body, media_type, limits)
    limits.require_size(header.frames, header.width, header.height)
    samples = header.width * header.height * header.frames * header.channels
    limits.require_ratio(samples * header.bits // 8, len(body))
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

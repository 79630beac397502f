"""What an image file says about itself, read and checked before any decoder allocates for it.

OpenCV's decoders are lenient: a file that is cut short comes back as an image with a grey rest. So it is
checked here whether a file is whole: PNG by its chunks and their CRCs (PNG specification, section 5), JPEG by
its end marker (ITU-T T.81, annex B), TIFF by its strips and tiles lying inside the file (TIFF 6.0).
"""

from __future__ import annotations

import zlib
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass

from service.errors import ImageError, UnsupportedMediaTypeError
from service.imaging.limits import DEFAULT_LIMITS, ImageLimits
from service.imaging.tiff import read_tiff_header


@dataclass(frozen=True)
class ImageHeader:
    """Size and sample format of every frame in a file."""

    width: int
    height: int
    channels: int  # as stored, without alpha: 1 or 3
    bits: int  # 8 or 16, after decoding
    frames: int = 1


_PNG_SIGNATURE = b"\x89PNG\r\n\x1a\n"
# format: PNG colour types: grey, RGB, palette, grey + alpha, RGBA
_PNG_COLOUR_CHANNELS = {0: 1, 2: 3, 3: 3, 4: 1, 6: 3}
_JPEG_START, _JPEG_END = b"\xff\xd8", b"\xff\xd9"
# format: JPEG, ISO/IEC 10918-1
_JPEG_FRAME_MARKERS = frozenset(range(0xC0, 0xD0)) - {0xC4, 0xC8, 0xCC}
_JPEG_SCAN_MARKER = 0xDA
_STARTS = (
    (_PNG_SIGNATURE, "image/png"),
    (_JPEG_START, "image/jpeg"),
    (b"II*\0", "image/tiff"),
    (b"MM\0*", "image/tiff"),
    (b"SIMPLE  =", "image/fits"),
    (b"\x1f\x8b", "image/fits"),  # packed: nothing else comes so
    (b"\x93NUMPY", "application/x-npy"),
    (b"LUCAM-RECORDER", "video/x-ser"),
    (b"RIFF", "video/avi"),
)
_ALIASES = {"image/jpg": "image/jpeg", "image/tif": "image/tiff", "image/x-png": "image/png"}


def read_header(body: bytes, media_type: str, limits: ImageLimits = DEFAULT_LIMITS) -> ImageHeader:
    """Header of an image file of this media type (parameters after ``;`` are ignored).

    Raises ``UnsupportedMediaTypeError``, or ``ImageError`` for a file that is empty, of another type than it
    says, cut short or damaged, ``TooLargeError`` for more frames than ``limits`` allow.
    """
    reader = _READERS.get(media_kind(media_type))
    if reader is None:
        supported = sorted(_READERS)
        raise UnsupportedMediaTypeError(
            f"media type {media_type!r} is not one of {', '.join(supported)}",
            field="header:Content-Type",
            supported=supported,
        )
    if not body:
        raise broken("the image is empty")
    header = reader(body, limits)
    if header.width < 1 or header.height < 1:
        raise broken(f"the image has no pixels ({header.width} x {header.height})")
    return header


def media_kind(media_type: str) -> str:
    """A media type without parameters, in lower case, by its usual name."""
    kind = media_type.split(";")[0].strip().lower()
    return _ALIASES.get(kind, kind)


def sniffed(body: bytes) -> str | None:
    """The media type that a body begins as; None: none that is known."""
    for start, kind in _STARTS:
        if body.startswith(start):
            return kind
    return "video/mp4" if body[4:8] == b"ftyp" else None


def broken(detail: str) -> ImageError:
    """The error for a body that is no whole image."""
    return ImageError(detail, field="body")


def _read_png(body: bytes, _: ImageLimits) -> ImageHeader:
    if not body.startswith(_PNG_SIGNATURE):
        raise broken("the media type says PNG, but the body does not begin with a PNG signature")
    header: ImageHeader | None = None
    for name, start, end in _png_chunks(body):
        if header is None:
            if name != b"IHDR" or end - start != 13:
                raise broken("PNG: the first chunk is no IHDR")
            bits, colour = body[start + 8], body[start + 9]
            channels = _PNG_COLOUR_CHANNELS.get(colour)
            if channels is None or bits not in (1, 2, 4, 8, 16):
                raise broken(f"PNG: colour type {colour} with {bits} bits does not exist")
            width, height = (int.from_bytes(body[start + k : start + k + 4], "big") for k in (0, 4))
            header = ImageHeader(width, height, channels, max(bits, 8))
        if name == b"IEND":
            return header
    raise broken("PNG: the file is cut short (no IEND chunk)")


def _png_chunks(body: bytes) -> Iterator[tuple[bytes, int, int]]:
    """Name, start and end of the data of each chunk; raises where one is cut short or fails its CRC."""
    at = len(_PNG_SIGNATURE)
    while at + 8 <= len(body):
        length, name = int.from_bytes(body[at : at + 4], "big"), body[at + 4 : at + 8]
        end = at + 8 + length
        if end + 4 > len(body):
            raise broken(f"PNG: the file is cut short inside its {name!r} chunk")
        if zlib.crc32(body[at + 4 : end]) != int.from_bytes(body[end : end + 4], "big"):
            raise broken(f"PNG: the {name!r} chunk is damaged (CRC)")
        yield name, at + 8, end
        at = end + 4


def _read_jpeg(body: bytes, _: ImageLimits) -> ImageHeader:
    if not body.startswith(_JPEG_START):
        raise broken("the media type says JPEG, but the body does not begin with a JPEG marker")
    header: ImageHeader | None = None
    for marker, start, end in _jpeg_segments(body):
        if marker in _JPEG_FRAME_MARKERS:
            if end - start < 6 or body[start] != 8:
                raise broken("JPEG: only 8 bits per sample are supported")
            height, width = (int.from_bytes(body[start + k : start + k + 2], "big") for k in (1, 3))
            header = ImageHeader(width, height, 1 if body[start + 5] == 1 else 3, 8)
        if marker == _JPEG_SCAN_MARKER:
            if header is None:
                raise broken("JPEG: image data before the frame header")
            if body.find(_JPEG_END, end) < 0:
                raise broken("JPEG: the file is cut short (no end marker)")
            return header
    raise broken("JPEG: the file is cut short (no image data)")


def _jpeg_segments(body: bytes) -> Iterator[tuple[int, int, int]]:
    """Marker, start and end of the payload of each segment up to the first scan."""
    at = len(_JPEG_START)
    while at + 4 <= len(body):
        if body[at] != 0xFF:
            raise broken("JPEG: damaged between its segments")
        marker = body[at + 1]
        if marker == 0xFF or 0xD0 <= marker <= 0xD8 or marker == 0x01:  # fill bytes, markers without payload
            at += 1 if marker == 0xFF else 2
            continue
        end = at + 2 + int.from_bytes(body[at + 2 : at + 4], "big")
        if end > len(body) or end < at + 4:
            raise broken("JPEG: the file is cut short inside its header")
        yield marker, at + 4, end
        at = end


def _read_tiff(body: bytes, limits: ImageLimits) -> ImageHeader:
    pages = read_tiff_header(body, limits)
    first = pages[0]
    for page in pages:
        if page != first:
            raise broken("TIFF: its frames differ in size or sample format")
    return ImageHeader(first.width, first.height, 1 if first.samples <= 2 else 3, first.bits, len(pages))


_READERS: Mapping[str, Callable[[bytes, ImageLimits], ImageHeader]] = {
    "image/png": _read_png,
    "image/jpeg": _read_jpeg,
    "image/tiff": _read_tiff,
}
MEDIA_TYPES = tuple(_READERS)

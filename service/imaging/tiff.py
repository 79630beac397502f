"""Directories of a TIFF or BigTIFF file: what each frame claims, checked against the bytes that are there."""

from __future__ import annotations

import struct
from dataclasses import dataclass

from service.errors import ImageError
from service.imaging.limits import ImageLimits

# format: TIFF 6.0 tags and types
_WIDTH, _HEIGHT, _BITS, _SAMPLES, _SAMPLE_FORMAT = 256, 257, 258, 277, 339
_DATA_TAGS = ((273, 279), (324, 325))  # offsets and byte counts of strips, of tiles
_TYPE_CODES = {1: "B", 3: "H", 4: "I", 16: "Q"}  # BYTE, SHORT, LONG, LONG8
_WANTED = frozenset((_WIDTH, _HEIGHT, _BITS, _SAMPLES, _SAMPLE_FORMAT, *(tag for pair in _DATA_TAGS for tag in pair)))
_UNSIGNED = 1


@dataclass(frozen=True)
class TiffPage:
    """One frame's size and samples."""

    width: int
    height: int
    samples: int
    bits: int


def read_tiff_header(body: bytes, limits: ImageLimits) -> list[TiffPage]:
    """Every frame of the file.

    Raises ``ImageError`` where a directory or its pixels lie outside the file, ``TooLargeError`` for too many frames.
    """
    if body[:4] in (b"II*\0", b"MM\0*"):
        reader = _Reader(body, "<" if body[:2] == b"II" else ">", big=False)
    elif body[:4] in (b"II+\0", b"MM\0+"):
        reader = _Reader(body, "<" if body[:2] == b"II" else ">", big=True)
    else:
        raise _broken("the media type says TIFF, but the body does not begin with a TIFF header")
    pages: list[TiffPage] = []
    seen: set[int] = set()
    offset = reader.first_directory()
    while offset:
        if offset in seen:
            raise _broken("TIFF: its directories form a loop")
        limits.require_size(len(pages) + 1, 1, 1)
        seen.add(offset)
        tags, offset = reader.directory(offset)
        pages.append(_page(tags, len(body)))
    if not pages:
        raise _broken("TIFF: it holds no image")
    return pages


@dataclass
class _Reader:
    """Numbers of a TIFF, in its byte order."""

    body: bytes
    order: str
    big: bool
    spent: int = 0

    def number(self, code: str, at: int) -> int:
        if at < 0 or at + struct.calcsize(code) > len(self.body):
            raise _broken("TIFF: the file is cut short (a directory lies outside of it)")
        return int(struct.unpack_from(self.order + code, self.body, at)[0])

    def spend(self, size: int) -> None:
        """Count what was read: directories could share their bytes, and then there would be no end to them."""
        self.spent += size
        if self.spent > len(self.body):
            raise _broken("TIFF: its directories refer to more bytes than the file has")

    def first_directory(self) -> int:
        return self.number("Q", 8) if self.big else self.number("I", 4)

    def directory(self, at: int) -> tuple[dict[int, tuple[int, ...]], int]:
        """The integer tags of a directory, and the offset of the next one."""
        word, entry_size = ("Q", 20) if self.big else ("I", 12)
        count_code = "Q" if self.big else "H"
        count = self.number(count_code, at)
        start = at + struct.calcsize(count_code)
        end = start + count * entry_size
        following = self.number(word, end)
        self.spend(end - at)
        tags: dict[int, tuple[int, ...]] = {}
        for entry in range(start, end, entry_size):
            code, tag = _TYPE_CODES.get(self.number("H", entry + 2)), self.number("H", entry)
            if code is not None and tag in _WANTED:
                tags[tag] = self._values(entry, code, word)
        return tags, following

    def _values(self, entry: int, code: str, word: str) -> tuple[int, ...]:
        count = self.number(word, entry + 4)
        size = count * struct.calcsize(code)
        at = entry + 4 + struct.calcsize(word)
        if size > struct.calcsize(word):
            at = self.number(word, at)
        if at + size > len(self.body):
            raise _broken("TIFF: the file is cut short (a tag's values lie outside of it)")
        self.spend(size)
        return struct.unpack_from(f"{self.order}{count}{code}", self.body, at)


def _page(tags: dict[int, tuple[int, ...]], length: int) -> TiffPage:
    if not tags.get(_WIDTH) or not tags.get(_HEIGHT):
        raise _broken("TIFF: a frame states no size")
    bits = tags.get(_BITS) or (1,)
    if len(set(bits)) != 1 or bits[0] not in (8, 16):
        raise _broken(f"TIFF: {bits[0]} bits per sample; 8 and 16 are supported")
    if set(tags.get(_SAMPLE_FORMAT) or (_UNSIGNED,)) != {_UNSIGNED}:
        raise _broken("TIFF: samples are no unsigned integers")
    chunks = [(tags[o], tags[c]) for o, c in _DATA_TAGS if tags.get(o) and tags.get(c)]
    if not chunks:
        raise _broken("TIFF: a frame has no pixels")
    for offsets, counts in chunks:
        if len(offsets) != len(counts) or any(o + c > length for o, c in zip(offsets, counts, strict=True)):
            raise _broken("TIFF: the file is cut short (pixels lie outside of it)")
    return TiffPage(tags[_WIDTH][0], tags[_HEIGHT][0], (tags.get(_SAMPLES) or (1,))[0], bits[0])


def _broken(detail: str) -> ImageError:
    return ImageError(detail, field="body")

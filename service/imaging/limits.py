"""How large an image file may be in every respect that costs memory or time, checked before anything is decoded."""

from __future__ import annotations

from dataclasses import dataclass

from service.errors import ImageError, TooLargeError

RATIO_FROM_BYTES = 1 << 26  # contract: decoded bytes up to which any compression is taken
"""Below so many bytes of pixels the ratio is not looked at: empty sky packs well, and little is at stake."""


@dataclass(frozen=True)
class ImageLimits:
    """Limits of one body. The defaults are those of docs/settings.md; errors name the setting."""

    pixels: int = 1 << 26  # all frames together
    frames: int = 10_000
    ratio: int = 200  # bytes of pixels per byte of file, beyond ``RATIO_FROM_BYTES``
    header_bytes: int = 1 << 20  # of a FITS header

    def require_size(self, frames: int, width: int, height: int) -> None:
        """Raises ``ImageError`` where there are no pixels, ``TooLargeError`` where there are too many."""
        if frames < 1 or width < 1 or height < 1:
            raise ImageError(f"the file has no pixels ({frames} frames of {width} x {height})", field="body")
        if frames > self.frames:
            raise _too_large(f"{frames} frames in one file", frames, self.frames, "SKYPOSE_MAX_IMAGE_FRAMES")
        pixels = width * height * frames
        if pixels > self.pixels:
            raise _too_large(f"{frames} x {width} x {height} pixels", pixels, self.pixels, "SKYPOSE_MAX_IMAGE_PIXELS")

    def require_ratio(self, unpacked: int, packed: int) -> None:
        """Raises ``TooLargeError`` where ``packed`` bytes claim to hold too many ``unpacked`` ones."""
        if unpacked > max(RATIO_FROM_BYTES, self.ratio * packed):
            what = f"{unpacked} bytes of pixels in {packed} bytes of file"
            raise _too_large(what, unpacked // max(packed, 1), self.ratio, "SKYPOSE_MAX_IMAGE_RATIO")

    def require_header(self, size: int) -> None:
        """Raises ``TooLargeError`` for a header of more than ``header_bytes``."""
        if size > self.header_bytes:
            raise _too_large(f"a header of {size} bytes", size, self.header_bytes, "SKYPOSE_MAX_HEADER_KB")


DEFAULT_LIMITS = ImageLimits()


def _too_large(what: str, found: int, limit: int, setting: str) -> TooLargeError:
    return TooLargeError(
        f"{what}: more than the limit of {limit}", field="body", limit=limit, found=found, setting=setting
    )

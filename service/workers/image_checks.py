"""Whether an image is what its session expects."""

from __future__ import annotations

from collections.abc import Iterable

from service.errors import ImageMismatchError
from service.imaging.decode import Frame as Image


def require_size(image: Image, size: tuple[int, int] | None) -> tuple[int, int]:
    """Width and height of a whole frame, which must be ``size`` where that is known."""
    height, width = image.image.shape[:2]
    if size is not None and size != (width, height):
        raise ImageMismatchError(f"the image is {width} x {height}, the background {size[0]} x {size[1]}", field="body")
    return width, height


def require_same(image: Image, shape: Iterable[int], bits: int) -> None:
    """Raises ``ImageMismatchError`` unless the image has this shape and depth."""
    expected = (*shape, bits)
    found = (*image.image.shape[:2], image.channels, image.bits)
    if found != expected:
        raise ImageMismatchError(
            "the image is {1} x {0} with {2} channel(s) of {3} bits, ".format(*found)
            + "the background {1} x {0} with {2} channel(s) of {3} bits".format(*expected),
            field="body",
        )

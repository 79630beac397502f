"""Whether an image is what its session expects."""

from __future__ import annotations

from collections.abc import Iterable

from service.errors import ConfigError, ImageMismatchError
from service.imaging.decode import Frame as Image

_MOST_ACROSS = 4.0  # of the image's longer side: of a body that is larger, no image shows enough


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


def require_sight(scale_px: tuple[float, float] | None, radius: float, size: tuple[int, int]) -> None:
    """Raises ``ConfigError`` where the least scale that is known makes a body of this radius (units) far too large.

    Mostly a unit is wrong, metres for millimetres; and a patch that held such a body would fill the memory.
    """
    across = 0.0 if scale_px is None else 2 * radius * scale_px[0]
    if across > _MOST_ACROSS * max(size):
        raise ConfigError(
            f"by what is told of its scale the body is {across:,.0f} px across, in an image of {size[0]} x {size[1]}: "
            "prior.scale_px, or prior.unit_m with camera.pixel_scale_arcsec, is wrong",
            field="prior",
        )

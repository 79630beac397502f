"""A frame with a silhouette drawn over it in blue (the paper's Table 1), for people to look at."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from service.errors import ImageError

RGB = NDArray[np.uint8]
Mask = NDArray[np.bool_]

# shown: all of them
BLUE = (40, 100, 255)
_TINT = 0.4
_LEAST_SPAN = {8: 64.0, 16: 256.0}
_MORE, _LESS = np.array([1.0, 0.62, 0.2]), np.array([0.3, 0.6, 1.0])  # told apart by colour-blind eyes too
_DARK_PERCENTILE, _BRIGHT_PERCENTILE = 1.0, 99.9


def for_display(image: NDArray[np.uint8] | NDArray[np.uint16]) -> RGB:
    """(H, W) or (H, W, 3) of 8 or 16 bits -> (H, W, 3) uint8 RGB.

    8-bit colour stays as it is. Anything else is stretched between its dark and bright percentiles; a frame of
    nothing but noise stays dark, because the stretch has a least span.
    """
    return stretched(image, *stretch_of(image))


def stretch_of(image: NDArray[np.uint8] | NDArray[np.uint16]) -> tuple[float, float]:
    """What of a frame (H, W) or (H, W, 3) is shown as black, and so much above it as white; counts."""
    bits = image.dtype.itemsize * 8
    if image.ndim == 3 and bits == 8:
        return 0.0, 255.0
    low, high = np.percentile(image, (_DARK_PERCENTILE, _BRIGHT_PERCENTILE))
    return float(low), max(float(high - low), _LEAST_SPAN[bits])


def stretched(image: NDArray[np.generic], low: float, span: float) -> RGB:
    """(H, W) or (H, W, 3) counts -> (H, W, 3) uint8 RGB."""
    shown = np.clip((image.astype(np.float32) - low) * (255.0 / span), 0, 255).astype(np.uint8)
    return shown if image.ndim == 3 else np.repeat(shown[:, :, None], 3, axis=2)


def draw_left_over(share: NDArray[np.floating]) -> RGB:
    """(H, W) of -1 to 1 -> (H, W, 3) uint8 RGB: orange where light is left, blue where too much was expected."""
    size = np.clip(np.abs(share), 0.0, 1.0)[:, :, None] * 255.0
    return np.asarray(np.rint(np.where(share[:, :, None] > 0, size * _MORE, size * _LESS)), np.uint8)


def draw_overlay(image: NDArray[np.uint8] | NDArray[np.uint16], mask: Mask) -> RGB:
    """(H, W, 3) uint8 RGB: the image, tinted blue where ``mask`` (H, W) is set, with a blue outline."""
    picture = for_display(image).astype(np.float32)
    picture[mask] = (1 - _TINT) * picture[mask] + _TINT * np.array(BLUE, dtype=np.float32)
    inside = cv2.erode(mask.astype(np.uint8), np.ones((3, 3), np.uint8), borderValue=0)
    picture[mask & (inside == 0)] = BLUE
    return np.rint(picture).astype(np.uint8)


def draw_silhouette(mask: Mask) -> RGB:
    """(H, W, 3) uint8 RGB: the silhouette alone, white on black."""
    return np.repeat(mask[:, :, None].astype(np.uint8) * np.uint8(255), 3, axis=2)


def encode_png(picture: RGB) -> bytes:
    """PNG bytes of an (H, W, 3) uint8 RGB picture."""
    done, data = cv2.imencode(".png", np.ascontiguousarray(picture[:, :, ::-1]))
    if not done:
        raise ImageError(f"a picture of shape {picture.shape} cannot be written as PNG")
    return data.tobytes()

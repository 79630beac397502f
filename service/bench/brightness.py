"""How strong the object stands out: a pass's signal-to-noise ratio from its own images."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from service.bench.silhouette import Mask
from service.imaging.decode import Pixels, decode_frame


class SkyLevel:
    """Mean and noise of the empty sky, channels averaged."""

    def __init__(self, images: Iterable[bytes]) -> None:
        stack = np.stack([grey(body) for body in images])
        self._mean = stack.mean(axis=0)
        spread = stack - self._mean if len(stack) > 1 else stack - stack.mean()
        freedom = (len(stack) - 1) / len(stack) if len(stack) > 1 else 1.0
        self._sigma = float(np.sqrt(np.mean(spread**2) / freedom))

    def snr(self, body: bytes, covered: Mask) -> float:
        """Mean light of the object's pixels above the sky, in units of one pixel's noise. NaN if it covers none."""
        if not covered.any():
            return float("nan")
        return float((grey(body) - self._mean)[covered].mean()) / max(self._sigma, 1e-9)


def pixels(body: bytes) -> Pixels:
    """(H, W) or (H, W, 3) RGB of a PNG."""
    return decode_frame(body, "image/png").image


def counts(values: NDArray[np.floating], like: Pixels) -> Pixels:
    """Values as counts of an image's depth."""
    kind: type[np.uint8] | type[np.uint16] = np.uint8 if like.dtype == np.uint8 else np.uint16
    found: Pixels = np.clip(np.rint(values), 0, np.iinfo(kind).max).astype(kind)
    return found


def to_power(image: Pixels, power: float) -> Pixels:
    """Counts that are an image's to a power, both as shares of full scale."""
    top = np.iinfo(image.dtype).max
    return counts((image / top) ** power * top, image)


def grey(body: bytes) -> NDArray[np.float64]:
    """(H, W) an image file's mean over channels."""
    image = pixels(body).astype(np.float64)
    return image if image.ndim == 2 else image.mean(axis=2)

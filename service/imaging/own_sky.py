"""The sky of a frame that shows the object: a smooth surface through what lies around it (``camera.background`` auto).

The surface is anchored at the image's border, where the object seldom is, and then fitted to all that is sky: level,
slopes and bends, and what is left of haze and cloud that is wide and faint beside the object.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from service.imaging.margins import margins_of

Map = NDArray[np.float32]
Array = NDArray[np.float64]

_BORDER_SHARE = 12  # numerical: of the shorter side: the ring from which the first guess comes
_ROUNDS = 4  # numerical: of outliers found and left out
SURFACE_SAMPLE = 16_384  # numerical: pixels that tell a surface, and its noise to half a percent
OUTLIER_SIGMAS = 4.0  # numerical: of one pixel
OF_A_NORMAL = 1.4826  # exact: its standard deviation, over the median of absolute deviations
_SMOOTH_PX = 1.5  # prior: light is at least so smooth
_LIGHT_SIGMAS = 5.0  # prior: after that smoothing: one pixel in a million of empty sky
# prior: of an object's extent, beyond it: what the air throws there is too faint to be seen as light
_FAINT_SHARE = 0.15
_FAINT_PX = 4  # prior: the same, of a small one
_BRIGHT_SHARE = 0.1  # prior: of the peak: light that is taken for the object's before the haze is known
_HAZE_SHARE = 0.1  # prior: of the image's side: what is narrower is no haze
_LITTLE = 1e-2  # numerical: share of what is seen where nothing is: the surface alone
_HAZE_SIDE_PX = 96  # numerical: it is smooth, so it is looked for in a picture of this size
# prior: share of an empty frame that is neither star nor hot; over so many sigmas it is never more than white noise
_SKY, _SKY_SIGMAS = 0.9, 2.2
_LEAST_SIGMA = 0.5  # exact: counts: below it quantisation is the noise


def own_sky(image: NDArray[np.generic], bits: int) -> tuple[NDArray[np.generic], NDArray[np.bool_]]:
    """The frame with a smooth sky in the place of every light, and the pixels (H, W) that do show sky.

    ``image`` (H, W) or (H, W, C) of integers of so many bits; the same shape and type come back.
    """
    data = np.asarray(image, np.float32)
    data = data[..., None] if data.ndim == 2 else data
    grey = data.mean(axis=2)
    margins = margins_of(image.reshape(data.shape), empty=False)
    shown = np.ones(grey.shape, np.bool_) if margins is None else ~margins
    ring = _ring(shown)
    surface, sigma = _surface(grey, ring)
    known = shown & ~_light((grey - surface) * shown, sigma, _BRIGHT_SHARE)
    known = _enough(known, ring, grey - surface, sigma)
    surface, sigma = _sky(grey, known)
    known = _enough(shown & ~_light((grey - surface) * shown, sigma), ring, grey - surface, sigma)
    whole = np.clip(np.rint(filled(data, known)), 0, (1 << bits) - 1).astype(image.dtype)
    return whole.reshape(image.shape), known


def filled(image: Map, known: NDArray[np.bool_]) -> Map:
    """``image`` (H, W, C) with a smooth surface through the ``known`` pixels (H, W) in the place of all others."""
    surfaces = [_sky(image[..., channel], known)[0] for channel in range(image.shape[2])]
    return np.where(known[..., None], image, np.stack(surfaces, axis=-1))


def surface_through(channel: Map, known: NDArray[np.bool_]) -> Map:
    """(H, W) level, slopes and bends through the ``known`` pixels of one channel."""
    return _surface(channel, known)[0]


def _ring(shown: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """(H, W) the border of what is shown."""
    edge = max(2, min(shown.shape) // _BORDER_SHARE)
    around = np.ones((2 * edge + 1, 2 * edge + 1), np.uint8)
    inner = cv2.erode(shown.astype(np.uint8), around, borderType=cv2.BORDER_CONSTANT, borderValue=0)
    return np.asarray(shown & (inner == 0))


def some_of(where: NDArray[np.bool_], most: int) -> NDArray[np.intp]:
    """Flat numbers of the pixels that are chosen, or of about so many of them, all over."""
    chosen = np.flatnonzero(where)
    return chosen[:: max(1, len(chosen) // most) | 1]  # odd: no column of an image of even width is left out


def fitted(columns: NDArray[np.float32], values: NDArray[np.float32], *, empty: bool = False) -> tuple[Array, float]:
    """Coefficients (T,) of ``columns`` (T, N) to (N,) pixels, and their noise, without what stands out: stars, hot
    pixels.

    ``empty``: nothing but sky and stars is there. Of a compressed image most of that may be one value: the median then
    says nothing of what is left, of which all but a tenth is sky.
    """
    level = np.zeros(len(columns))
    level[0] = np.median(values)
    sigma = _LEAST_SIGMA
    for _ in range(_ROUNDS):
        residual = values - level @ columns
        sigma = max(OF_A_NORMAL * float(np.median(np.abs(residual))), _LEAST_SIGMA)
        if empty:
            sigma = max(sigma, float(np.quantile(np.abs(residual), _SKY)) / _SKY_SIGMAS)
        inside = np.abs(residual) <= OUTLIER_SIGMAS * sigma
        chosen = columns[:, inside]
        level = np.linalg.lstsq(chosen @ chosen.T, chosen @ values[inside], rcond=None)[0]
    return level, sigma


def _surface(channel: Map, where: NDArray[np.bool_]) -> tuple[Map, float]:
    """(H, W) level, slopes and bends through the chosen pixels, and the noise about them."""
    height, width = channel.shape
    across, down = (np.linspace(-1, 1, size, dtype=np.float32) for size in (width, height))
    chosen = some_of(where, SURFACE_SAMPLE)
    rows, columns = np.divmod(chosen, width)
    x, y = across[columns], down[rows]
    level, sigma = fitted(np.stack([np.ones_like(x), x, y, x * x, x * y, y * y]), channel.ravel()[chosen])
    whole, right, below, bend, twist, sag = level.astype(np.float32)
    surface = whole + right * across + bend * across**2 + (below * down + sag * down**2)[:, None]
    return surface + (twist * down)[:, None] * across, sigma


def _enough(known: NDArray[np.bool_], ring: NDArray[np.bool_], above: Map, sigma: float) -> NDArray[np.bool_]:
    """Where the object is nearly everywhere, the border is all there is."""
    return known if known.sum() >= ring.sum() / 2 else ring & (np.abs(above) <= OUTLIER_SIGMAS * sigma)


def _sky(channel: Map, known: NDArray[np.bool_]) -> tuple[Map, float]:
    """The whole smooth surface, and the noise about it."""
    surface, sigma = _surface(channel, known)
    chosen = some_of(known, SURFACE_SAMPLE)
    for _ in range(2):
        left = channel - surface
        sky = (known & (np.abs(left) <= OUTLIER_SIGMAS * sigma)).astype(np.float32)
        haze = _haze(left * sky, sky)
        sigma = max(OF_A_NORMAL * float(np.median(np.abs((left - haze).ravel()[chosen]))), _LEAST_SIGMA)
        surface = surface + haze
    return surface, sigma


def _haze(light: Map, weight: Map) -> Map:
    """(H, W) what is wide of ``light``, known where ``weight`` is; nothing where nothing is known."""
    height, width = light.shape
    scale = min(1.0, _HAZE_SIDE_PX / max(height, width))
    size = max(round(width * scale), 1), max(round(height * scale), 1)
    far = _HAZE_SHARE * max(size)
    some, seen = (
        cv2.GaussianBlur(cv2.resize(one, size, interpolation=cv2.INTER_AREA), (0, 0), far) for one in (light, weight)
    )
    return np.asarray(cv2.resize(some / (seen + _LITTLE), (width, height), interpolation=cv2.INTER_LINEAR), np.float32)


def _light(above: Map, sigma: float, share: float = 0.0) -> NDArray[np.bool_]:
    """(H, W) where something is brighter or darker than the sky, with what lies too near to be trusted.

    ``share`` of the peak, from which on it counts, if that is more than what noise makes.
    """
    smooth = np.abs(cv2.GaussianBlur(above, (0, 0), _SMOOTH_PX))
    noise = sigma / (2 * np.sqrt(np.pi) * _SMOOTH_PX)
    light = smooth > max(_LIGHT_SIGMAS * noise, share * float(smooth.max()))
    count, labels, stats, _ = cv2.connectedComponentsWithStats(light.astype(np.uint8))
    out = np.zeros(light.shape, dtype=bool)
    for k in range(1, count):
        left, top, width, height, _ = stats[k]
        far = _FAINT_PX + round(_FAINT_SHARE * max(width, height))
        rows, columns = slice(max(top - far, 0), top + height + far), slice(max(left - far, 0), left + width + far)
        near = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * far + 1, 2 * far + 1))
        out[rows, columns] |= cv2.dilate((labels[rows, columns] == k).astype(np.uint8), near).astype(bool)
    return out

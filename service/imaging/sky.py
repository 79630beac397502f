"""What a worker derives from a background once, and keeps: the sky at every pixel, its noise, and p(D|b)."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import cv2
import numpy as np
from numpy.typing import NDArray

from service.imaging.background import FLOOR, KEPT_FRAMES, Background
from service.imaging.black import sigma_behind_black
from service.imaging.clutter import Box, cluttered_box
from service.imaging.features import FeatureSpec, feature_spec
from service.imaging.frame_median import median_of
from service.imaging.margins import either, margins_of
from service.imaging.noise import SQUARE, as_loud_as, from_pixel_to_pixel, noise_of, over_squares, sigmas
from service.imaging.own_sky import (
    OF_A_NORMAL,
    OUTLIER_SIGMAS,
    SURFACE_SAMPLE,
    filled,
    fitted,
    some_of,
    surface_through,
)

_HOT_SIGMAS = 6.0  # prior: above a smooth sky: a hot pixel
_GLYPH_PX = 9  # prior: strokes of a clock's digits lie no further apart
STAR_PX = 11  # prior: extent of a bright star above the threshold
_ONCE = 2  # exact: changes of what comes and goes once
_SAMPLE = 32_768  # numerical: pixels of a frame that tell its level, and noise to half a percent
_TOLD_BY = 64  # prior: counts above the least that tell by which step they go: no stars' alone
_ALIKE = 0.2  # prior: of neighbours that chance would leave different: more are so by compression
_SMOOTH_PX, _SMOOTH_SHARE = 2.0, 1 / 40  # prior: an empty sky is smooth over so much, at the least; of a side
_COARSE_PX = 256  # numerical: a side at which a sky is smoothed


@dataclass(frozen=True)
class Sky:
    """Derived from a background, cached by content."""

    mean: NDArray[np.float32]  # (H, W, C) brightness per pixel
    covariance: NDArray[np.float64]  # (C, C) of one pixel's noise, as loud over squares as if it were white
    log_density: NDArray[np.float64]  # (bins,) log p(D|b) of the feature
    spec: FeatureSpec
    clutter: Box | None = None  # in which the body was told to lie, where there is more than sky about it
    unsure: NDArray[np.bool_] | None = None  # (H, W) where a clock changes, or nothing was shown; None: nowhere
    step: int = 1  # by which counts go: 16 where a camera of 12 bits fills 16
    fine: float = 1.0  # its noise from pixel to pixel, in that of a pixel: of white noise 1; 0: none shows

    @property
    def sigma(self) -> NDArray[np.float64]:
        """(C,) noise of one pixel."""
        return np.asarray(np.sqrt(np.diag(self.covariance)))


def derive(background: Background, feature: str, gradient_sigma_px: float) -> Sky:
    """Mean, noise and p(D|b) of a background.

    The mean is the per-pixel median over frames whose own plane has been taken out, lightly smoothed while there
    are few frames, and a smooth surface through what is known where no frame showed the sky; the noise is the
    deviation about it without outliers, so stars do not count.
    """
    channels = background.shape[2]
    spec = feature_spec(feature, channels, background.bits, gradient_sigma_px)
    counts = background.counts
    density = (1 - FLOOR) * counts / max(1.0, counts.sum()) + FLOOR / spec.n_bins
    shown, never = _shown(background.frames)
    known = background.known & ~never
    known = known if known.any() else background.known
    some = _squares(known)
    sample = shown[:, *some].astype(np.int64)
    step = _step(sample, known[some])
    counted = shown if step == 1 else shown.astype(np.float32) / np.float32(step)
    planes = _planes(counted, known, some)
    frames = np.subtract(counted, planes, dtype=np.float32)
    mean = median_of(frames)
    if not known.all():  # elsewhere it is the object that was seen
        mean = filled(mean, known)
    few = len(frames) < KEPT_FRAMES
    middle = mean
    smooth = np.stack([_smooth_sky(mean[..., c]) for c in range(channels)], axis=-1) if few else mean
    residual = frames[:, *some] - smooth[some]
    noise = noise_of(residual[:, known[some]])
    noise = as_loud_as(noise, sigma_behind_black(sample // step, known[some]))
    if few:
        mean = _with_hot(smooth, mean, frames, noise) if len(frames) > 2 else smooth
    noise = over_squares(residual, known[some], noise)
    rounded = noise + np.diag(np.maximum(0.25 - np.diag(noise), 0.0))  # below half a step quantisation is the noise
    return Sky(
        np.ascontiguousarray(step * (mean + median_of(planes)), dtype=np.float32),
        step**2 * rounded,
        np.log(density),
        spec,
        cluttered_box(background.frames[-1], known),
        either(_unsure(frames, middle, smooth, noise), never if never.any() else None),
        step,
        from_pixel_to_pixel(residual, known[some], rounded),
    )


def _shown(frames: NDArray[np.generic]) -> tuple[NDArray[np.generic], NDArray[np.bool_]]:
    """(K, H, W, C) with what others show in the place of a frame's margins, and (H, W) what none shows."""
    margins = [margins_of(frame, empty=True) for frame in frames]
    nothing = np.zeros(frames.shape[1:3], np.bool_)
    if all(one is None for one in margins):
        return frames, nothing
    shows = ~np.stack([nothing if one is None else one for one in margins])
    count = shows.sum(axis=0)[..., None]
    mean = np.sum(frames, axis=0, where=shows[..., None], dtype=np.float64) / np.maximum(count, 1)
    return np.where(shows[..., None], frames, np.rint(mean).astype(frames.dtype)), count[..., 0] == 0


def _step(counts: NDArray[np.int64], known: NDArray[np.bool_]) -> int:
    """By which (K, H, W, C) counts go where ``known`` (H, W): 16 where a camera of 12 bits fills 16, more where images
    were posterised. Where neighbours are more alike than by chance an image was compressed: its squares tell.
    """
    above = counts[:, known].ravel()
    above -= above.min()
    step = int(np.gcd.reduce(above)) if np.count_nonzero(above) >= _TOLD_BY else 1
    if step == 1:
        return 1
    by_chance = float(np.sum((np.bincount(above // step) / len(above)) ** 2))
    alike = float(np.mean((counts[:, :, 1:] == counts[:, :, :-1])[:, known[:, 1:] & known[:, :-1]]))
    return step if alike < by_chance + _ALIKE * (1 - by_chance) else 1


def _squares(known: NDArray[np.bool_]) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Rows and columns of the squares that tell level and noise, all over: so many as hold about ``_SAMPLE`` pixels; of
    a small frame, or where they would miss what is known, all of it.
    """
    every = max(1, round(np.sqrt(known.size / _SAMPLE)))
    rows, columns = (np.arange(size) for size in known.shape)
    some = [at[(at // SQUARE % every == 0) & (at < len(at) - len(at) % SQUARE)] for at in (rows, columns)]
    if every > 1 and int(known[np.ix_(*some)].sum()) >= min(int(known.sum()), _SAMPLE) / 4:
        return some[0][:, None], some[1][None]
    return rows[:, None], columns[None]


def _with_hot(
    smooth: NDArray[np.float32], mean: NDArray[np.float32], frames: NDArray[np.float32], noise: NDArray[np.float64]
) -> NDArray[np.float32]:
    """(H, W, C) a ``smooth`` sky, but for pixels whose ``mean`` stands out of it in all of (K, H, W, C) ``frames``.

    Where a telescope follows its object stars pass, and are gone when it is there; hot pixels stay.
    """
    stands = mean - smooth
    hot = np.abs(stands) > _HOT_SIGMAS * sigmas(noise)
    above = (frames[:, hot] - smooth[hot]) * np.sign(stands[hot])
    hot[hot] = (above > 0.5 * np.abs(stands[hot])).all(axis=0)
    return np.where(hot, mean, smooth)


def _planes(
    frames: NDArray[np.generic], known: NDArray[np.bool_], some: tuple[NDArray[np.intp], NDArray[np.intp]]
) -> NDArray[np.float32]:
    """(K, H, W, C) level and slopes of each frame's own sky, from what is ``known`` (H, W) of ``some`` of its pixels:
    dusk and moonlight change them from frame to frame.
    """
    height, width = known.shape
    across, down = (np.linspace(-1, 1, size, dtype=np.float32) for size in (width, height))
    chosen = some_of(known[some], SURFACE_SAMPLE)
    x, y = (np.broadcast_to(one, known[some].shape).ravel()[chosen] for one in (across[some[1]], down[some[0]]))
    terms = np.stack([np.ones_like(x), x, y])
    seen = frames[:, *some].reshape(len(frames), -1, frames.shape[3])[:, chosen].astype(np.float32)
    found = np.array([[fitted(terms, values, empty=True)[0] for values in frame.T] for frame in seen], np.float32)
    level, right, below = np.moveaxis(found, 2, 0)[:, :, None, None]
    return np.asarray((level + right * across[:, None]) + below * down[:, None, None], np.float32)


def _unsure(
    frames: NDArray[np.float32], middle: NDArray[np.float32], smooth: NDArray[np.float32], noise: NDArray[np.float64]
) -> NDArray[np.bool_] | None:
    """(H, W) where things come and go in (K, H, W, C) empty ``frames``, as the digits of a clock; None: nowhere.

    A star comes and goes once, and where it twinkles it is no wider than a star. What stands out of the sky and touches
    such a place may change next: the clock's hours.
    """
    least = _HOT_SIGMAS * sigmas(noise).astype(np.float32)
    off = [(np.abs(frame - middle) > least).any(axis=2) for frame in frames]
    often = np.sum([now != before for before, now in pairwise(off)], axis=0, dtype=np.uint8)
    comes_and_goes = often > _ONCE
    if not comes_and_goes.any():
        return None
    stands = np.any(off, axis=0) | (np.abs(middle - smooth) > least).any(axis=2)
    _, labels = cv2.connectedComponents(cv2.dilate(stands.astype(np.uint8), np.ones((_GLYPH_PX, _GLYPH_PX), np.uint8)))
    places = ((one, np.argwhere(comes_and_goes & (labels == one))) for one in np.unique(labels[comes_and_goes]))
    wide = [one for one, pixels in places if np.ptp(pixels, axis=0).max() >= STAR_PX]
    return np.isin(labels, wide) if wide else None


def _smooth_sky(mean: NDArray[np.float32]) -> NDArray[np.float32]:
    """Low-pass of one channel in which stars do not leak: outliers are replaced by the coarse level around them.

    What slopes and bends across the whole image is left as it is: near a border a low pass would bend it. The coarse
    level is an average without the outliers, which are known only once there is a coarse level: three rounds are
    enough.
    """
    height, width = mean.shape
    sigma, coarser = max(_SMOOTH_PX, _SMOOTH_SHARE * min(mean.shape)), max(1, min(mean.shape) // _COARSE_PX)
    size = width // coarser, height // coarser

    def low(image: NDArray[np.generic], share: float = 1.0) -> NDArray[np.float32]:
        """Smoothed, at the size at which that is quick."""
        small = cv2.resize(np.asarray(image, np.float32), size, interpolation=cv2.INTER_AREA)
        return np.asarray(cv2.GaussianBlur(small, (0, 0), share * sigma / coarser), np.float32)

    def whole(small: NDArray[np.float32]) -> NDArray[np.float32]:
        return np.asarray(cv2.resize(small, (width, height), interpolation=cv2.INTER_LINEAR), np.float32)

    everywhere = np.ones(mean.shape, dtype=np.bool_)
    surface, chosen = surface_through(mean, everywhere), some_of(everywhere, _SAMPLE)
    left, sky = mean - surface, everywhere
    coarse = left
    for _ in range(3):
        coarse = whole(low(left * sky) / (low(sky) + 1e-3))  # in the midst of a wide outlier: the surface
        deviation = np.abs(left - coarse)
        sky = deviation <= OUTLIER_SIGMAS * OF_A_NORMAL * np.median(deviation.ravel()[chosen]) + 1e-6
    return surface + whole(low(np.where(sky, left, coarse), 0.5))

"""How loud noise is: of a pixel, of squares of them, and from pixel to pixel, whatever is smooth below it."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from service.imaging.own_sky import OF_A_NORMAL, OUTLIER_SIGMAS

Map = NDArray[np.float32]
_BOARD = np.outer([1, -2, 1], [1, -2, 1]).astype(np.float32) / 6.0  # exact: white noise stays as loud
SQUARE, _CHANCE = 8, 6.0  # prior: px that noise may be alike over; standard deviations that chance does not reach
_LOUD, _BEYOND = 0.98, 1.5  # prior: of squares: more are full of stars; of white noise less than four sigma
_EVEN = 4.0  # prior: sigmas between a square's quartiles: white noise has 1.3, a text many
_LEAST_SIGMA = 0.3  # exact: counts: quantisation alone has 0.29
_PLANE = 3  # exact: numbers of a frame's own plane, which its squares no longer have
_FINE_FRAMES = 4  # numerical: of which noise from pixel to pixel is told
_WHITE = 0.5  # prior: of a pixel's noise, from pixel to pixel: where less is left a program was at work
_ALIKE_PX = 9.0  # exact: pixels of a board's square: neighbours' share most of theirs


def checkerboard(image: Map) -> Map:
    """(H, W) its finest part, to which the point spread lets little light through; as loud as the image if white."""
    return np.asarray(cv2.filter2D(image, cv2.CV_32F, _BOARD), np.float32)


def loudness(values: Map) -> float:
    """Root mean square of what lies within four of the robust deviations; 0 of nothing."""
    size = np.abs(values)
    inside = size[size <= OUTLIER_SIGMAS * OF_A_NORMAL * np.median(size)] if size.size else size
    return float(np.sqrt(np.mean(inside**2, dtype=np.float64))) if inside.size else 0.0


def louder(now: float, usual: float, count: int) -> float:
    """How many times as loud a frame is, of so many pixels, as empty ones are; 1 where that may be chance.

    Both from pixel to pixel, in the noise of a pixel: gain and exposure change it, and so does moonlight.
    """
    if now <= 0 or usual < _WHITE:
        return 1.0
    chance = _CHANCE * np.sqrt(_ALIKE_PX / (2 * count))
    return now / usual if abs(np.log(now / usual)) > chance else 1.0


def weights(covariance: NDArray[np.float64]) -> NDArray[np.float64]:
    """(C,) shares of the channels with which the noise of their sum is least, were it not alike."""
    weight = 1.0 / np.diag(covariance)
    return np.asarray(weight / weight.sum())


def noise_of(residual: NDArray[np.float32], loud: NDArray[np.float32] | float = 0.0) -> NDArray[np.float64]:
    """(K, M, C) -> (C, C) covariance of what lies within four of the robust deviations, or is no more than ``loud``.

    The median absolute deviation alone is a step function of the noise where counts are whole numbers: up to a
    fifth off at two counts.
    """
    robust = OF_A_NORMAL * np.median(np.abs(residual), axis=(0, 1))
    inside = np.abs(residual) <= np.maximum(OUTLIER_SIGMAS * np.maximum(robust, 0.5), loud)
    seen = np.where(inside, residual, 0.0).reshape(-1, residual.shape[2]).astype(np.float64)
    both = inside.reshape(seen.shape).astype(np.float64)
    return np.asarray(seen.T @ seen / np.maximum(1.0, both.T @ both))


def as_loud_as(noise: NDArray[np.float64], sigma: NDArray[np.float64]) -> NDArray[np.float64]:
    """(C, C) the same with (C,) standard deviations at the least, and as alike between the channels."""
    now = np.sqrt(np.diag(noise))
    alike = noise / np.maximum(np.outer(now, now), 1e-12)
    np.fill_diagonal(alike, 1.0)
    raised = np.maximum(now, sigma)
    return np.asarray(alike * np.outer(raised, raised))


def sigmas(noise: NDArray[np.float64]) -> NDArray[np.float64]:
    """(C,) of a pixel, of a covariance; that of rounding at the least."""
    return np.maximum(np.sqrt(np.diag(noise)), _LEAST_SIGMA)


def over_squares(
    residual: NDArray[np.float32], known: NDArray[np.bool_], noise: NDArray[np.float64]
) -> NDArray[np.float64]:
    """``noise`` (C, C) of a pixel, or of white noise that is as loud over squares, where that is more than chance.

    Noise of enlarged, stacked or filtered images is alike in neighbours. As light is as smooth there, white noise that
    is as loud over a square says what such an image can tell. Of images that were compressed most of the sky is one
    value, and the rest is off by whole squares, often by the same from frame to frame: no pixel's noise shows it, and
    no difference of frames. What white noise would do is told by as many pixels from all over.
    """
    n, height, width, channels = residual.shape
    rows, columns, pixels = height // SQUARE, width // SQUARE, SQUARE**2
    shape = (n, rows, SQUARE, columns, SQUARE, channels)
    whole = known[: rows * SQUARE, : columns * SQUARE].reshape(shape[1:5]).all(axis=(1, 3))
    count = int(np.count_nonzero(whole))
    if count <= _PLANE:
        return noise
    squares = residual[:, : rows * SQUARE, : columns * SQUARE].reshape(shape).swapaxes(2, 3)[:, whole]
    together = squares.reshape(n, count, pixels, channels)
    apart = squares.reshape(n, pixels, count, channels).swapaxes(1, 2)
    loud, white = (_loudness(one, sigmas(noise)) for one in (together, apart))
    loud *= count / (count - _PLANE)
    chance = _CHANCE * np.sqrt(2 / (n * count))
    return loud if np.trace(loud) > max((1 + chance) * np.trace(white), np.trace(noise)) else noise


def _loudness(groups: NDArray[np.float32], sigma: NDArray[np.float64]) -> NDArray[np.float64]:
    """(K, M, P, C) pixels -> (C, C) covariance of white noise whose means over P are as loud as those of the groups'
    middle halves, in which there is no star. ``sigma`` (C,) of a pixel: where these differ by more it is no sky.
    """
    pixels = groups.shape[2]
    quarter = pixels // 4
    middle = np.sort(groups, axis=2)[:, :, quarter:-quarter]
    even = (middle[:, :, -1] - middle[:, :, 0] <= _EVEN * sigma).all(axis=2)
    if not even.any():
        return np.zeros((len(sigma), len(sigma)))
    means = np.float32(np.sqrt(pixels)) * middle.mean(axis=2)[even][None]
    return noise_of(means, _BEYOND * np.quantile(np.abs(means), _LOUD, axis=(0, 1)).astype(np.float32))


def from_pixel_to_pixel(residual: NDArray[np.float32], known: NDArray[np.bool_], noise: NDArray[np.float64]) -> float:
    """How loud ``noise`` (C, C) is from pixel to pixel, in that of a pixel: of white noise 1; 0: none shows.

    Of the first of (K, H, W, C) empty frames, less their sky, where they are ``known`` (H, W).
    """
    share = weights(noise)
    fine = [checkerboard(np.asarray(one @ share, np.float32))[known] for one in residual[:_FINE_FRAMES]]
    return loudness(np.concatenate(fine)) / float(np.sqrt(share @ noise @ share))

"""Kolmogorov turbulence in the telescope's pupil: short-exposure point spreads with speckle.

A periodic phase screen is filtered from white noise (power spectrum 0.023 r0^(-5/3) f^(-11/3), R. J. Noll,
J. Opt. Soc. Am. 66, 207 (1976)) and blown across the pupil (frozen flow, G. I. Taylor). Tip and tilt are taken
out: they move the image as a whole and belong to the truth of the pass.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

_PUPIL_SAMPLES = 48
_SCREEN_SAMPLES = 512
_EXPOSURE_STEPS = 3
_KOLMOGOROV = 0.023
_TILT_VARIANCE = 0.170  # one-axis gradient tilt, rad^2 of the phase slope, over (D/r0)^(5/3) (lambda/D)^2


def image_motion_px(d_over_r0: float, airy_px: float) -> float:
    """Standard deviation of the image motion in each axis. ``airy_px`` is lambda / D in pixels."""
    return float(np.sqrt(_TILT_VARIANCE * d_over_r0 ** (5 / 3)) * airy_px)


class Turbulence:
    """A sequence of point-spread functions. ``d_over_r0`` is the aperture over Fried's length."""

    def __init__(self, d_over_r0: float, airy_px: float, wind_share: float, rng: np.random.Generator) -> None:
        self._screen = _phase_screen(_PUPIL_SAMPLES / d_over_r0, rng)
        self._pupil = _pupil()
        self._pad = round(_PUPIL_SAMPLES * airy_px) | 1  # odd: the middle sample is the centre
        self._step = wind_share * _PUPIL_SAMPLES / _EXPOSURE_STEPS
        self._at = rng.uniform(0, _SCREEN_SAMPLES, 2)
        angle = rng.uniform(0, 2 * np.pi)
        self._wind = np.array([np.cos(angle), np.sin(angle)])

    def next_psf(self) -> NDArray[np.float64]:
        """The point spread of the next exposure: (S, S), S odd, of sum 1, centred; one sample is one pixel."""
        total = np.zeros((self._pad, self._pad))
        for _ in range(_EXPOSURE_STEPS):
            phase = self._window()
            field = np.zeros((self._pad, self._pad), dtype=np.complex128)
            field[:_PUPIL_SAMPLES, :_PUPIL_SAMPLES] = self._pupil * np.exp(1j * phase)
            total += np.abs(np.fft.fft2(field)) ** 2
            self._at = self._at + self._step * self._wind
        return _centred(np.fft.fftshift(total) / total.sum())

    def _window(self) -> NDArray[np.float64]:
        index = np.arange(_PUPIL_SAMPLES)
        rows = (int(self._at[0]) + index) % _SCREEN_SAMPLES
        columns = (int(self._at[1]) + index) % _SCREEN_SAMPLES
        return _without_tilt(self._screen[np.ix_(rows, columns)], self._pupil)


def _pupil() -> NDArray[np.float64]:
    """A round aperture with a central obscuration of 0.25."""
    axis = (np.arange(_PUPIL_SAMPLES) + 0.5) / (0.5 * _PUPIL_SAMPLES) - 1.0
    radius = np.hypot(*np.meshgrid(axis, axis))
    return np.asarray((radius <= 1.0) & (radius >= 0.25), dtype=np.float64)


def _phase_screen(r0_samples: float, rng: np.random.Generator) -> NDArray[np.float64]:
    """A periodic screen in radians; Fried's length given in samples."""
    n = _SCREEN_SAMPLES
    frequency = np.fft.fftfreq(n)
    radius = np.hypot(*np.meshgrid(frequency, frequency))
    radius[0, 0] = np.inf  # the mean of the phase has no effect
    amplitude = np.sqrt(_KOLMOGOROV) * r0_samples ** (-5 / 6) * radius ** (-11 / 6)
    noise = rng.standard_normal((n, n)) + 1j * rng.standard_normal((n, n))
    # Each frequency cell has the area 1 / n^2; the inverse transform's 1 / n^2 is taken back.
    return np.asarray(np.real(np.fft.ifft2(noise * amplitude)) * n)


def _without_tilt(phase: NDArray[np.float64], pupil: NDArray[np.float64]) -> NDArray[np.float64]:
    axis = np.arange(_PUPIL_SAMPLES) - 0.5 * (_PUPIL_SAMPLES - 1)
    x, y = np.meshgrid(axis, axis)
    inside = pupil > 0
    plane = np.column_stack([np.ones(inside.sum()), x[inside], y[inside]])
    fit = np.linalg.lstsq(plane, phase[inside], rcond=None)[0]
    return np.asarray(phase - fit[0] - fit[1] * x - fit[2] * y)


def _centred(psf: NDArray[np.float64]) -> NDArray[np.float64]:
    """The point spread with its centroid moved onto the middle sample."""
    size = len(psf)
    index = np.arange(size)
    middle = size // 2
    shift_x = middle - float((psf.sum(axis=0) * index).sum())
    shift_y = middle - float((psf.sum(axis=1) * index).sum())
    matrix = np.array([[1.0, 0.0, shift_x], [0.0, 1.0, shift_y]])
    moved = cv2.warpAffine(psf, matrix, (size, size), flags=cv2.INTER_LINEAR)
    return np.asarray(moved / moved.sum(), dtype=np.float64)

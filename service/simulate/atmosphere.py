"""What the air does to a picture: blur, speckle, warping, scintillation."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.signal import fftconvolve

from service.simulate.turbulence import Turbulence, image_motion_px

Floats32 = NDArray[np.float32]


@dataclass(frozen=True)
class Air:
    """Seeing. With ``d_over_r0`` 0 the point spread is the Gaussian alone."""

    psf_sigma_px: float = 1.0
    """Gaussian blur of optics, long-exposure air and pixels together."""
    d_over_r0: float = 0.0
    """Aperture over Fried's length: phase-screen speckle and image motion; 0 is off, 5 is poor."""
    airy_px: float = 2.0
    """lambda / D in pixels, for the speckle."""
    wind_share: float = 0.5
    """How far the air moves during an exposure, as a share of the aperture."""
    shake_px: float = 0.0
    """Further image motion in each axis, from frame to frame."""
    warp_px: float = 0.0
    """Standard deviation of local shifts (several layers seen through at once)."""
    warp_length_px: float = 40.0
    """Distance over which they are alike."""
    scintillation: float = 0.0
    """Standard deviation of the logarithm of the brightness."""
    memory: float = 0.5
    """Correlation of warp and scintillation from frame to frame."""

    def image_motion_px(self) -> float:
        """Standard deviation of the image motion in each axis, of all causes."""
        if self.d_over_r0 <= 0:
            return self.shake_px
        return float(np.hypot(self.shake_px, image_motion_px(self.d_over_r0, self.airy_px)))


class Atmosphere:
    """Applies the air of one pass, exposure by exposure, to images of one ``size`` (width, height)."""

    def __init__(self, air: Air, size: tuple[int, int], rng: np.random.Generator) -> None:
        self._air, self._size, self._rng = air, size, rng
        self._turbulence: Turbulence | None = None
        if air.d_over_r0 > 0:
            self._turbulence = Turbulence(air.d_over_r0, air.airy_px, air.wind_share, rng)
        self._warp = _Remembered(self._grid_shape(), air.memory, rng)
        self._brightness = _Remembered((1,), air.memory, rng)

    def expose(self, *layers: Floats32) -> tuple[Floats32, ...]:
        """The next exposure: radiance, then layers (coverage, stars) on the same path, (H, W) each."""
        psf = None if self._turbulence is None else self._turbulence.next_psf()
        shift = self._shift_map(layers[0])
        return tuple(self._seen(layer, psf, shift) for layer in layers)

    def gain(self) -> float:
        """Brightness of the next exposure relative to the mean (log-normal)."""
        spread = self._air.scintillation
        return float(np.exp(spread * self._brightness.step()[0] - 0.5 * spread * spread))

    def _seen(
        self, layer: Floats32, psf: NDArray[np.float64] | None, shift: tuple[Floats32, Floats32] | None
    ) -> Floats32:
        if not layer.any():
            return layer
        if shift is not None:
            layer = cv2.remap(layer, *shift, cv2.INTER_LINEAR).astype(np.float32)
        if psf is not None:
            layer = fftconvolve(layer, psf, mode="same").astype(np.float32)
        if self._air.psf_sigma_px > 0:
            layer = cv2.GaussianBlur(layer, (0, 0), self._air.psf_sigma_px).astype(np.float32)
        return np.maximum(layer, 0)

    def _grid_shape(self) -> tuple[int, int, int]:
        width, height = self._size
        cell = self._air.warp_length_px
        return 2, int(np.ceil(height / cell)) + 3, int(np.ceil(width / cell)) + 3

    def _shift_map(self, radiance: Floats32) -> tuple[Floats32, Floats32] | None:
        """Where each pixel's light comes from (x, y), without a shift of the body as a whole."""
        if self._air.warp_px <= 0:
            return None
        width, height = self._size
        fields = [cv2.resize(g, self._size, interpolation=cv2.INTER_CUBIC) for g in self._warp.step()]
        shifts = [f * (self._air.warp_px / max(float(f.std()), 1e-6)) for f in fields]
        x, y = np.meshgrid(np.arange(width), np.arange(height))
        maps = (x + shifts[0]).astype(np.float32), (y + shifts[1]).astype(np.float32)
        if not radiance.any():
            return maps
        warped = cv2.remap(radiance, *maps, cv2.INTER_LINEAR).astype(np.float32)
        moved = _centroid(warped) - _centroid(radiance)
        return maps[0] + moved[0], maps[1] + moved[1]


def _centroid(light: Floats32) -> NDArray[np.float32]:
    """(x, y) of the light."""
    total = max(float(light.sum()), 1e-12)
    columns, rows = light.sum(axis=0), light.sum(axis=1)
    x, y = (np.dot(part, np.arange(len(part))) / total for part in (columns, rows))
    return np.array([x, y], dtype=np.float32)


class _Remembered:
    """White noise in space, of unit variance, that forgets from frame to frame (AR(1))."""

    def __init__(self, shape: tuple[int, ...], memory: float, rng: np.random.Generator) -> None:
        self._rng, self._memory = rng, memory
        self._value = rng.standard_normal(shape)

    def step(self) -> NDArray[np.float64]:
        fresh = self._rng.standard_normal(self._value.shape)
        self._value = self._memory * self._value + np.sqrt(1 - self._memory**2) * fresh
        return self._value

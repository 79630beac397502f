"""From light to numbers: sky, stars, photon and read noise, gain, bit depth, saturation."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

_CLOUDS_ACROSS = 12.0
_GROUND_POWER = 2.0  # of the amplitude of a wave with its length

Image = NDArray[np.uint8] | NDArray[np.uint16]


@dataclass(frozen=True)
class Camera:
    """A sensor and what it looks at beside the body. Grey unless ``colour``."""

    bits: int = 8
    """8 or 16."""
    colour: bool = False
    """Three channels, red, green, blue."""
    signal_e: float = 500.0
    """Electrons from a white facet that faces the sun."""
    body_colour: tuple[float, float, float] = (1.0, 0.97, 0.9)
    """Its share in red, green, blue."""
    sky_e: tuple[float, float, float] = (12.0, 12.0, 12.0)
    """Electrons from the sky in red, green, blue (grey: the middle one), at the image's centre."""
    sky_gradient: float = 0.0
    """Relative change of the sky from the image's top to its bottom."""
    cloud: float = 0.0
    """Standard deviation of thin cloud over the sky's mean; it stands still."""
    airlight: float = 1.0
    """Share of the sky's light that comes from in front of the body: 1 in space, less for a near body."""
    read_noise_e: float = 6.0
    """Standard deviation of the read noise."""
    electrons_per_count: float = 4.0
    """Gain."""
    bias_counts: float = 12.0
    """Count of no light."""
    full_well_e: float = 60_000.0
    """Electrons at which a pixel saturates."""
    stars: int = 0
    """Stars in a field four times the image."""
    star_e: float = 1800.0
    """Electrons of the brightest; the others are fainter by a power law."""
    star_rate_px_s: tuple[float, float] = (-20.0, 12.0)
    """Drift of the stars."""
    ground: float = 0.0
    """Brightest of a ground behind the body, in white facets that face the Sun."""
    ground_rate_px_s: tuple[float, float] = (30.0, 20.0)
    """Drift of the ground."""

    @property
    def channels(self) -> int:
        """1 or 3."""
        return 3 if self.colour else 1


class Sensor:
    """Reads images of one ``size`` (width, height); the sky and the star field are drawn once."""

    def __init__(self, camera: Camera, size: tuple[int, int], rng: np.random.Generator) -> None:
        self._camera, self._size = camera, size
        self._sky = _sky(camera, size)
        self._star_at = rng.uniform(-0.5, 1.5, (camera.stars, 2)) * size
        self._star_light = camera.star_e * rng.uniform(0.05, 1.0, camera.stars) ** 2
        if camera.cloud > 0:
            self._sky = self._sky * (1.0 + camera.cloud * _cloud(size, rng))[..., None]
        self._ground = _ground(2 * max(size), rng) if camera.ground > 0 else None

    def ground_layer(self, time_s: float) -> NDArray[np.float32] | None:
        """(H, W) light of the ground at a time, in white facets; None: there is none. It repeats itself."""
        if self._ground is None:
            return None
        width, height = self._size
        right, down = (round(rate * time_s) for rate in self._camera.ground_rate_px_s)
        return np.roll(self._ground, (down, right), (0, 1))[:height, :width] * np.float32(self._camera.ground)

    def star_layer(self, time_s: float, exposure_s: float) -> NDArray[np.float32]:
        """(H, W) electrons of the stars at a time, as short trails, before the air and the optics."""
        width, height = self._size
        out = np.zeros((height, width), dtype=np.float32)
        rate = np.array(self._camera.star_rate_px_s)
        steps = max(1, int(np.ceil(float(np.abs(rate).max()) * exposure_s * 2)))
        for step in range(steps):
            when = time_s + exposure_s * (step + 0.5) / steps
            at = (self._star_at + rate * when + 0.5 * np.array(self._size)) % (2 * np.array(self._size))
            at -= 0.5 * np.array(self._size)
            column, row = np.floor(at).astype(np.int64).T
            inside = (column >= 0) & (column < width) & (row >= 0) & (row < height)
            np.add.at(out, (row[inside], column[inside]), self._star_light[inside] / steps)
        return out

    def read(
        self,
        radiance: NDArray[np.float32],
        coverage: NDArray[np.float32],
        stars: NDArray[np.float32],
        rng: np.random.Generator,
        ground: NDArray[np.float32] | None = None,
    ) -> Image:
        """An image, (H, W) or (H, W, 3): the body's light (1 is white in full sun), its coverage, stars and ground."""
        camera = self._camera
        open_sky = (1.0 - (1.0 - camera.airlight) * coverage)[..., None] * self._sky
        if ground is not None:
            radiance = radiance + (1.0 - coverage) * ground
        colour = np.array(camera.body_colour if camera.colour else (1.0,))
        starlight = ((1.0 - coverage) * stars)[..., None]
        electrons = open_sky + camera.signal_e * radiance[..., None] * colour + starlight
        counted = np.minimum(rng.poisson(electrons), camera.full_well_e)
        noisy = counted + camera.read_noise_e * rng.standard_normal(electrons.shape)
        counts = np.rint(noisy / camera.electrons_per_count + camera.bias_counts)
        clipped = np.clip(counts, 0, (1 << camera.bits) - 1)
        image = clipped.astype(np.uint8 if camera.bits == 8 else np.uint16)
        return image if camera.colour else np.ascontiguousarray(image[..., 0])


def _cloud(size: tuple[int, int], rng: np.random.Generator) -> NDArray[np.float64]:
    """(H, W) smooth noise of unit variance."""
    width, height = size
    smooth = gaussian_filter(rng.standard_normal((height, width)), max(size) / _CLOUDS_ACROSS)
    return np.asarray((smooth - smooth.mean()) / max(float(smooth.std()), 1e-12), dtype=np.float64)


def _ground(side: int, rng: np.random.Generator) -> NDArray[np.float32]:
    """(side, side) from 0 to 1, of as many scales as there are, each as strong as it is wide; its edges meet."""
    frequency = np.hypot(np.fft.fftfreq(side)[:, None], np.fft.rfftfreq(side)[None])
    frequency[0, 0] = np.inf
    waves = np.fft.rfft2(rng.standard_normal((side, side))) / frequency**_GROUND_POWER
    image = np.fft.irfft2(waves, (side, side))
    return np.asarray((image - image.min()) / np.ptp(image), np.float32)


def _sky(camera: Camera, size: tuple[int, int]) -> NDArray[np.float64]:
    """(H, W, C) electrons of the empty sky."""
    height = size[1]
    slope = 1.0 + camera.sky_gradient * ((np.arange(height) + 0.5) / height - 0.5)
    level = np.array(camera.sky_e if camera.colour else camera.sky_e[1:2])
    return np.broadcast_to(slope[:, None, None] * level, (height, size[0], len(level)))

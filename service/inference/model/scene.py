"""A patch of a frame as the likelihood sees it: what is fixed before poses are compared."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache
from math import log

import numpy as np
from numpy.typing import NDArray

from service.inference.model import prior
from service.inference.model.spread import PointSpread, spread

Images = NDArray[np.float32]
_BUMPS, _BUMP_WIDTH = (0.25, 0.5, 0.75), 0.2  # prior: of a patch's side: where the air shifts the image alike
_BRIGHTER = 0.99  # numerical: quantile of a frame's light from which its gain is guessed, 3 sigma at the least
# numerical: of a pixel's light that comes from where nothing is known: then nothing is known of it
_UNSEEN_SHARE = 0.05
_FULL_SHARE = 0.5  # numerical: of a pixel that is full: then it is
# numerical: a frequency's noise, in standard deviations, and its transfer's deviations (h), a factor, that are allowed
_NOISE_SIGMAS, _DEVIATION = 4.0, 2.0


@dataclass(frozen=True)
class Scene:
    """One patch as the likelihood sees it: what is fixed before poses are compared."""

    image: Images  # (S, S) light above the sky, counts
    sigma: float  # noise of one pixel of empty sky, counts
    photon: float  # variance per count
    sky: float  # counts of the empty sky, with what the sensor adds to it
    full: NDArray[np.floating | np.bool_]  # (S, S) share of a pixel that is at the sensor's upper end
    point_spread: PointSpread
    discrepancy: float = prior.DISCREPANCY  # tau
    shifts: bool = True  # whether speckle and image shifts are unknowns: not worth their time in a coarse look
    low_pass: float = 0.0  # l, px; 0: as the point spread asks
    grain: float = 1.0  # px in which lengths of the discrepancy are told: a share of the body, on any patch
    light: prior.LightPrior = field(default_factory=prior.LightPrior)
    starry: NDArray[np.uint8] | None = None  # (S, S) numbers of light that may be a star's, 0 elsewhere
    starry_alone: NDArray[np.uint8] | None = None  # (S, S) the same where the object is absent; None: no more
    unseen: NDArray[np.bool_] | None = None  # (S, S) where nothing is known; None: nowhere
    hides: float | None = None  # counts of the sky's light that the body hides; None: as likely as its prior has it
    seen_photon: float | None = None  # variance per count, as the frame's finest checkerboard has it
    uneven: Images | None = None  # (S, S) counts of the empty sky at a place, over `sky`; None: alike everywhere

    @property
    def side(self) -> int:
        """S."""
        return len(self.image)

    @cached_property
    def smoothing(self) -> float:
        """l, px."""
        return self.low_pass or prior.LOW_PASS_SHARE * self.point_spread.width

    @cached_property
    def data(self) -> Images:
        """(S, S) the frame after its low pass."""
        return np.asarray(spread(self.image[None], PointSpread(0.0), self.smoothing)[0], np.float32)

    @cached_property
    def area(self) -> float:
        """A: pixels that count as one."""
        taps = np.exp(-0.5 * (np.arange(-64, 65) / max(self.smoothing, 1e-3)) ** 2)
        taps /= taps.sum()
        return float(1.0 / np.sum(taps**2) ** 2)

    @cached_property
    def alike(self) -> float:
        """c: pixels' areas over which the discrepancy is alike."""
        return max(1.0, (self.grain * prior.DISCREPANCY_LENGTH) ** 2 / self.area)

    @property
    def hidden(self) -> float:
        """S: light of the sky that a body can hide at the most, counts: its photons are no more than its noise."""
        return min(self.sky, prior.PHOTON_UNSURE * self.sigma**2 / max(self.photon, 1e-12))

    def share_of_sky(self, counts: float) -> float:
        """So much hidden light, as a share of S; 0 where no sky can be hidden."""
        return min(counts / self.hidden, 1.0) if self.hidden > 0 else 0.0

    @cached_property
    def unknown(self) -> NDArray[np.bool_]:
        """(S, S) pixels of which nothing is known after the low pass."""
        return np.zeros(self.image.shape, bool) if self.unseen is None else self._of(self.unseen)

    @cached_property
    def censored(self) -> NDArray[np.bool_]:
        """(S, S) pixels of which only a least value is known.

        What full ones lack is lacking around them after the low pass, too. But were all that is known of these a least
        value, a bright body's rim could go outwards at no cost.
        """
        return np.asarray(self.unknown | (self.full >= _FULL_SHARE))

    @cached_property
    def behind(self) -> Images:
        """(S, S) light of the sky that a body can hide at a place, over its level, after the low pass."""
        if self.uneven is None:
            return np.ones(self.image.shape, np.float32)
        return np.asarray(1 + spread(self.uneven[None] - 1, PointSpread(0.0), self.smoothing)[0], np.float32)

    @cached_property
    def stars(self) -> NDArray[np.uint8]:
        """(S, S) the number of what may be a star's light, after the low pass; 0 elsewhere."""
        return self._passed(self.starry)

    @cached_property
    def stars_alone(self) -> NDArray[np.uint8]:
        """(S, S) the same where the object is absent."""
        return self.stars if self.starry_alone is None else self._passed(self.starry_alone)

    def _passed(self, starry: NDArray[np.uint8] | None) -> NDArray[np.uint8]:
        out = np.zeros(self.image.shape, np.uint8)
        for number in [] if starry is None else np.unique(starry[starry > 0])[::-1]:
            out[self._of(starry == number)] = number
        return out

    def _of(self, some: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """(S, S) to which some pixels bring light with the low pass."""
        if not some.any():
            return some
        return np.asarray(spread(some.astype(np.float32)[None], PointSpread(0.0), self.smoothing)[0] > _UNSEEN_SHARE)

    @cached_property
    def gain(self) -> float:
        """Log gain to start from: that of the brighter light in the frame."""
        return log(max(float(np.quantile(self.data, _BRIGHTER)), 3 * self.sigma))

    @cached_property
    def _least_transfer(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """(S, S / 2 + 1) wavenumbers, 1 / px, and what a point spread must let through of each, as a share.

        No frequency of light that is nowhere negative is larger than its sum. A body darker than its sky adds to that.
        A pixel that stands out of all its neighbours, or a pair, is a cosmic ray's, and no light.
        """
        down = 2 * np.pi * np.fft.fftfreq(self.side)[:, None]
        wavenumbers = np.hypot(down, 2 * np.pi * np.fft.rfftfreq(self.side))
        seen = float(np.sum(np.abs(self.image), dtype=np.float64))
        noise = _NOISE_SIGMAS * np.sqrt(self.image.size * self.sigma**2 + self.photon * seen)
        dark = self.hidden * np.count_nonzero(np.abs(self.image) > _NOISE_SIGMAS * self.sigma)
        whole = max(float(np.sum(self.image, dtype=np.float64)), 0.0) + dark + noise
        around = [np.roll(self.image, (a, b), (0, 1)) for a in (-1, 0, 1) for b in (-1, 0, 1) if a or b]
        light = np.minimum(self.image, np.partition(around, -2, axis=0)[-2])
        return wavenumbers, (np.abs(np.fft.rfft2(light)) - noise) / (_DEVIATION * whole)

    def lets_through(self, point_spread: PointSpread) -> bool:
        """Whether light could leave this frame through such a point spread (px): none is sharper than it."""
        wavenumbers, least = self._least_transfer
        return bool(np.all(point_spread.transfer(wavenumbers) >= least))

    def under(
        self,
        *,
        point_spread: PointSpread | None = None,
        discrepancy: float | None = None,
        photon: float | None = None,
        hides: float | None = None,
    ) -> Scene:
        """The same frame, with the low pass it has, under another point spread, discrepancy, photon transfer or hidden
        sky.
        """
        other = replace(
            self,
            point_spread=point_spread or self.point_spread,
            discrepancy=self.discrepancy if discrepancy is None else discrepancy,
            photon=self.photon if photon is None else photon,
            hides=self.hides if hides is None else hides,
            low_pass=self.smoothing,
        )
        # of the frame and its low pass alone
        for name in ("data", "area", "unknown", "censored", "behind", "stars", "gain"):
            other.__dict__[name] = getattr(self, name)
        return other


@lru_cache(maxsize=16)
def sky_slopes(side: int) -> Images:
    """(3, S, S) level and two slopes across a patch."""
    axis = np.linspace(-1, 1, side, dtype=np.float32)
    across, down = np.meshgrid(axis, axis)
    return _kept(np.stack([np.ones_like(across), across, down]))


@lru_cache(maxsize=16)
def shift_bumps(side: int) -> Images:
    """(9, S, S) smooth bumps a third of the body apart: where the air shifts the image alike."""
    middle = np.array(_BUMPS) * side
    at = np.arange(side) + 0.5
    line = np.exp(-0.5 * ((at[None] - middle[:, None]) / (_BUMP_WIDTH * side)) ** 2)
    return _kept(np.asarray(np.einsum("ai,bj->abij", line, line).reshape(9, side, side), np.float32))


def _kept(pictures: Images) -> Images:
    pictures.flags.writeable = False
    return pictures

"""The resolutions at which a search looks at a frame (docs/model.md, section 4)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from service.inference.model import prior
from service.inference.model.drawing import FINE, Drawing, Lens, Quality, View
from service.inference.model.nuisance import Nuisance
from service.inference.model.scene import Scene
from service.inference.numerics.hill import Hill, Trust
from service.inference.numerics.priors import PosePrior
from service.inference.state import Array


class PatchLike(Protocol):
    """``service.imaging.patch.Patch``."""

    @property
    def image(self) -> NDArray[np.float32]:
        """(S, S) light above the sky, counts."""
        ...

    @property
    def sigma(self) -> float:
        """Noise of one pixel of empty sky, counts."""
        ...

    @property
    def photon(self) -> float:
        """Variance per count."""
        ...

    @property
    def sky(self) -> float:
        """Counts of the empty sky, with what the sensor adds to it; of a frame pixel, as the image."""
        ...

    @property
    def full(self) -> NDArray[np.float32]:
        """(S, S) share of a pixel that is at the sensor's upper end."""
        ...

    @property
    def uneven(self) -> NDArray[np.float32] | None:
        """(S, S) counts of the empty sky at a place, over `sky`; None: alike everywhere."""
        ...

    @property
    def unseen(self) -> NDArray[np.bool_]:
        """(S, S) pixels of which nothing is known."""
        ...

    @property
    def stars(self) -> NDArray[np.uint8]:
        """(S, S) numbers of pieces of light that may be stars; 0 elsewhere."""
        ...

    @property
    def stars_alone(self) -> NDArray[np.uint8] | None:
        """(S, S) the same where the object is absent: what would be its light may be stars, too; None: no more."""
        ...

    @property
    def origin(self) -> tuple[float, float]:
        """First corner, frame px."""
        ...

    @property
    def binning(self) -> float:
        """Frame px a patch px."""
        ...


@dataclass(frozen=True)
class Sight:
    """A frame as a search sees it."""

    patch: Callable[[tuple[float, float], float, float], PatchLike]  # centre and span (px), patch px that this fills
    centre: tuple[float, float]  # of the light, frame px
    span: float  # of the light, px
    psf: float  # first guess of the point spread's width, px
    lens: Lens | None = None
    pieces: Array = field(default_factory=lambda: np.empty((0, 4)))  # boxes of all light, frame px

    def cut(self, span: float, wanted: float) -> PatchLike:
        """The patch around the centre in which so many px fill so many patch px."""
        return self.patch(self.centre, span, wanted)

    def over(self, lit: Callable[[Lens | None], Array | None]) -> Sight:
        """The same, grown until it holds the pieces of light in a box.

        ``lit``: left, top, right, bottom (frame px) of that box through a lens, or None; asked where light is left out.
        """
        low, high = np.subtract(self.centre, 0.5 * self.span), np.add(self.centre, 0.5 * self.span)
        middles = 0.5 * (self.pieces[:, :2] + self.pieces[:, 2:])
        out = np.any((middles < low) | (middles > high), axis=1)
        box = lit(self.lens) if out.any() else None
        if box is None:
            return self
        within = out & np.all((middles >= box[:2]) & (middles <= box[2:]), axis=1)
        if not within.any():
            return self
        low = np.minimum(low, self.pieces[within, :2].min(axis=0))
        high = np.maximum(high, self.pieces[within, 2:].max(axis=0))
        x, y = 0.5 * (low + high)
        return replace(self, centre=(float(x), float(y)), span=float((high - low).max()))


@dataclass(frozen=True)
class Body:
    """One body, drawn from roughly to finely."""

    rough: Drawing
    middle: Drawing
    fine: Drawing


@dataclass(frozen=True)
class Part:
    """One of so many equal parts of a search, which goes on over as many frames."""

    number: int = 0
    count: int = 1

    @property
    def is_last(self) -> bool:
        """Whether all have been searched with it."""
        return self.number + 1 >= self.count

    @property
    def own(self) -> slice:
        """Its things of a row of them."""
        return slice(self.number, None, self.count)

    def share(self, count: int) -> int:
        """Its share of so many; rounded up, and two at the least where more parts share them."""
        return count if self.count == 1 else max(-(-count // self.count), 2)


WHOLE = Part()


@dataclass(frozen=True)
class Stage:
    """One resolution of a search. All numbers are numerical: a search that stops early misses the truth, no more."""

    wanted: float  # patch px that the light spans
    low_pass: float  # patch px, at the least
    kept: int  # basins that climb
    steps: int  # of Gauss-Newton
    difference: float  # patch px
    quality: Quality
    trust: Trust
    off: float = 0.0  # discrepancy at the least: a pose that is degrees off draws a body as a wrong mesh does

    def of(self, part: Part) -> Stage:
        """The stage of a part of a search."""
        return replace(self, kept=part.share(self.kept))


# numerical: all of them
FIRST = Stage(22, 1.0, 150, 1, 1.0, Quality(2, 96, ()), Trust(0.2, 0.15, 0.15, 0.4), 0.04)
ROUGH = Stage(22, 1.0, 56, 2, 1.0, Quality(2, 96, ()), Trust(0.2, 0.15, 0.15, 0.4), 0.04)
MIDDLE = Stage(28, 1.0, 24, 2, 0.7, Quality(2, 128), Trust())
SHARP = Stage(44, 0.8, 10, 2, 0.6, Quality(3, 192), Trust())
CLEAR = Stage(64, 1.2, 8, 6, 0.7, Quality(4, 256), Trust())  # the whole body, with speckle, still smooth
FINEST = Stage(96, 0.7, 5, 6, 0.5, FINE, Trust())
COARSE_ROUNDS = 4  # numerical: of reweighting
# numerical: patch px in a point spread's width: speckle of a short exposure is finer than that width
SAMPLED = 1.8


def stage_hill(
    drawing: Drawing, sight: Sight, stage: Stage, nuisance: Nuisance, told: PosePrior, *, speckle: bool
) -> Hill:
    """What poses climb on at a stage; no finer than the point spread lets anything through."""
    blurred = SAMPLED * sight.span / nuisance.point_spread(1).width
    patch = sight.cut(sight.span, min(stage.wanted, blurred))
    grain = sight.span / stage.wanted / patch.binning  # less than 1 where the light spans fewer px than are wanted
    spread = nuisance.point_spread(patch.binning)
    scene = Scene(
        patch.image,
        patch.sigma,
        nuisance.photon_on(patch.binning) or prior.PHOTON_SHARE * patch.photon,
        patch.sky,
        patch.full,
        spread,
        max(nuisance.discrepancy, stage.off),
        speckle,
        max(grain * stage.low_pass, stage.low_pass / patch.binning, prior.LOW_PASS_SHARE * spread.width),
        grain=grain,
        starry=patch.stars,
        starry_alone=patch.stars_alone,
        unseen=patch.unseen,
        hides=nuisance.hides,
        seen_photon=patch.photon,
        uneven=patch.uneven,
        light=told.light,
    )
    view = View(patch.origin, patch.binning, len(patch.image), sight.lens, told.light.around)
    free = speckle or told.towards_sun is None
    rounds = 6 if speckle else COARSE_ROUNDS
    return Hill(scene, drawing, view, told, stage.quality, stage.difference, free, rounds, stage.trust)

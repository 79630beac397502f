"""What all poses of a frame share: point spread, discrepancy, photon transfer, hidden sky (docs/model.md, 3).

Found at its best poses, then held.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from service.inference.model import prior
from service.inference.model.scene import Scene
from service.inference.model.spread import PointSpread
from service.inference.numerics.hill import Hill, Looked
from service.inference.state import Array

_WIDTHS = tuple(float(v) for v in 0.4 * 10 ** (np.arange(20) / 11))  # numerical: grid, to 21 px of the frame: enlarged
_SHARES = (0.0, 0.25, 0.5, 0.7, 0.85, 0.95)  # numerical: grid: of the width's square that is the wings'
# numerical: grid, two standard deviations of its log either way, and in wider steps what a wrong mesh may ask for
_LOGS = (*np.linspace(-1.4, 1.4, 13), 1.75, 2.1, 2.45, 2.8)
_AMOUNTS = (0.0, 0.5, 1.0, 1.5, 2.2, 3.3)  # numerical: grid, of an unsharp mask
_MASKS = (0.7, 1.0, 1.4, 2.0, 2.8, 4.0)  # numerical: grid, frame px
_DISCREPANCIES = tuple(float(prior.DISCREPANCY * np.exp(v)) for v in _LOGS)
_PHOTON_STEP = 1.41  # numerical: half a standard deviation of its log
_PHOTONS = tuple(float(_PHOTON_STEP**k) for k in range(-6, 3))  # numerical: grid, of what the frame's checkerboard has
_HIDDEN = (0.0, 0.25, 0.5, 0.75, 1.0)  # numerical: grid: share of the most that can be hidden
_HIDDEN_STEPS = (1 / 8, 1 / 16, 1 / 32)  # numerical: by which it is refined
_Place = tuple[int, int, int, int]  # on the grids of width, wings' share, amount and width of an unsharp mask
_GRIDS = (_WIDTHS, _SHARES, _AMOUNTS, _MASKS)
# exact: a step along each; of what goes against what: width and wings, amount and width (sharpening hides a blur),
# amount and width of the mask
_OPTICS: tuple[_Place, ...] = (
    *((1, 0, 0, 0), (-1, 0, 0, 0), (0, 1, 0, 0)),
    *((0, -1, 0, 0), (-1, 1, 0, 0), (1, -1, 0, 0)),
)
_MASKED: tuple[_Place, ...] = ((0, 0, 1, 0), (1, 0, 1, 0))
_SHARPENED: tuple[_Place, ...] = (
    *_MASKED,
    *((0, 0, -1, 0), (-1, 0, -1, 0), (0, 0, 0, 1), (0, 0, 0, -1), (0, 0, -1, 1), (0, 0, 1, -1)),
)
_BLURRED = (0, 2, 4)  # numerical: steps of width that a blur may be wider than it looks after sharpening
_EVERY_MASK = tuple((a, m) for a in range(1, len(_AMOUNTS)) for m in range(len(_MASKS)))
_MASK_PX = 2.0  # numerical: where the mask's width is looked for first
_FIVE = 5  # exact: point spread's width and wings, discrepancy, photons, hidden sky
_LOOKS = 24  # numerical: grids are searched from where one stands: no more than this
_STRIDES = (3, 1)  # numerical: steps over the grids of discrepancy and photons


@dataclass(frozen=True)
class Nuisance:
    """Of one frame; px of the frame."""

    core: float  # s
    wings: float = 0.0  # w
    discrepancy: float = prior.DISCREPANCY
    photon: float | None = None  # variance per count of light; None: as each frame's finest checkerboard has it
    hides: float | None = None  # counts of the sky's light that the body hides; None: not looked for yet
    sharpened: float = 0.0  # p
    mask: float = 0.0  # m

    def point_spread(self, binning: float) -> PointSpread:
        """On a patch of squares of so many px."""
        return PointSpread(self.core / binning, self.wings / binning, self.sharpened, self.mask / binning)

    def spread_by(self, width: float, share: float) -> Nuisance:
        """The same with a point spread of such a width (px of the frame), of whose square the wings have a share."""
        spread = PointSpread.of(width, share)
        return replace(self, core=spread.core, wings=spread.wings)

    def sharpened_by(self, amount: float, mask: float) -> Nuisance:
        """The same after an unsharp mask of such an amount and width (px of the frame)."""
        return replace(self, sharpened=amount, mask=mask)

    def photon_on(self, binning: float) -> float | None:
        """Variance per count on the same; None: as the frame has it."""
        return None if self.photon is None else self.photon / binning**2


def best_spread(at: Looked, start: Nuisance) -> Nuisance:
    """The point spread under which a few poses explain the frame best, by steps over a grid.

    None through which the frame's own sharpest light could not come: a mesh that is wrong asks for a blur.
    The frame's own low pass stays what the hill has: all are compared on the same data.
    """
    grid = _Grid(at, start, {})
    here = _place_of(start)
    while here[0] > 0 and not grid.allows(here):
        here = (here[0] - 1, *here[1:])
    grid.look([here], anyway=True)
    if not here[2]:
        grid.climb(_OPTICS, _LOOKS)
        grid.look([_stepped(grid.best, step) for step in _MASKED])
        if grid.best[2]:  # a blur that was sharpened is not met by single steps
            width, share, *_ = grid.best
            grid.look([(width + more, share, *mask) for more in _BLURRED for mask in _EVERY_MASK])
    if grid.best[2]:
        grid.climb((*_OPTICS, *_SHARPENED), len(grid.seen) + _LOOKS)
    return grid.under(grid.best)


@dataclass(frozen=True)
class _Grid:
    """Point spreads, and how well those that were looked at explain a frame."""

    at: Looked
    start: Nuisance
    seen: dict[_Place, float]

    @property
    def best(self) -> _Place:
        """Of those that were looked at."""
        return max(self.seen, key=lambda place: self.seen[place])

    def under(self, place: _Place) -> Nuisance:
        """The start with the point spread of a place."""
        width, share, amount, mask = place
        return self.start.spread_by(_WIDTHS[width], _SHARES[share]).sharpened_by(_AMOUNTS[amount], _MASKS[mask])

    def allows(self, place: _Place) -> bool:
        """Whether it is one, and the frame could be light that came through it."""
        on_it = all(0 <= k < len(values) for k, values in zip(place, _GRIDS, strict=True))
        return on_it and lets_through(self.at.hill, self.under(place))

    def look(self, places: list[_Place], anyway: bool = False) -> None:
        """At those that are allowed and new."""
        new = [one for one in places if one not in self.seen and (anyway or self.allows(one))]
        if not new:
            return
        hill, tried = self.at.hill, [self.under(place) for place in new]
        scenes = [hill.scene.under(point_spread=one.point_spread(hill.view.binning)) for one in tried]
        found = self.at.log_evidences(scenes).max(axis=1) + [_log_prior(one) for one in tried]
        self.seen.update(zip(new, map(float, found), strict=True))

    def climb(self, steps: tuple[_Place, ...], looks: int) -> None:
        """From the best, until no step betters it or so many were looked at."""
        here = None
        while here != self.best and len(self.seen) < looks:
            here = self.best
            self.look([_stepped(here, step) for step in steps])


def _stepped(place: _Place, step: _Place) -> _Place:
    """A step further; what was not sharpened has no mask whose width could change."""
    width, share, amount, mask = (a + b for a, b in zip(place, step, strict=True))
    return (width, share, amount, mask) if amount else (width, share, 0, _MASKS.index(_MASK_PX))


def _place_of(nuisance: Nuisance) -> _Place:
    """The nearest on the grid."""
    spread = nuisance.point_spread(1)
    return (
        int(np.argmin(np.abs(np.log(np.array(_WIDTHS) / spread.width)))),
        int(np.argmin(np.abs(np.array(_SHARES) - spread.share))),
        int(np.argmin(np.abs(np.array(_AMOUNTS) - spread.sharpened))),
        int(np.argmin(np.abs(np.array(_MASKS) - (spread.mask if spread.sharpened else _MASK_PX)))),
    )


def best_discrepancy(at: Looked, start: Nuisance) -> Nuisance:
    """The discrepancy under which the best pose explains the frame best, prior included, by steps over its grid."""
    grid, scene = _DISCREPANCIES, at.hill.scene

    def values(places: list[int]) -> Array:
        found = at.log_evidences([scene.under(discrepancy=grid[k]) for k in places]).max(axis=1)
        return np.asarray(found + [_log_prior_of_discrepancy(grid[k]) for k in places], np.float64)

    return replace(start, discrepancy=grid[highest(values, _nearest(grid, start.discrepancy), len(grid))])


def best_photon(at: Looked, start: Nuisance) -> Nuisance:
    """The photon transfer under which the best pose explains the frame best, prior included, by steps over its grid."""
    scene, squares = at.hill.scene, at.hill.view.binning**2
    seen = scene.photon if scene.seen_photon is None else scene.seen_photon

    def values(places: list[int]) -> Array:
        found = at.log_evidences([scene.under(photon=seen * _PHOTONS[k]) for k in places]).max(axis=1)
        return np.asarray(found + [_log_prior_of_photon(_PHOTONS[k]) for k in places], np.float64)

    share = prior.PHOTON_SHARE if start.photon is None else start.photon / squares / seen
    return replace(start, photon=seen * _PHOTONS[highest(values, _nearest(_PHOTONS, share), len(_PHOTONS))] * squares)


def highest(values: Callable[[list[int]], Array], here: int, count: int) -> int:
    """Where on a grid of so many places a function with one top is highest, by wide steps, then by narrow ones."""
    seen: dict[int, float] = {}
    for step in _STRIDES:
        there = None
        while there != here:
            there = here
            new = [k for k in (here, here - step, here + step) if 0 <= k < count and k not in seen]
            if new:
                seen.update(zip(new, map(float, values(new)), strict=True))
            here = max(seen, key=lambda place: seen[place])
    return here


def best_hidden(at: Looked, start: Nuisance) -> Nuisance:
    """The light of the sky that the body hides under which a few poses explain the frame best.

    Of each pose alone it is all but free: more light that hides more of the sky is the same image, but has more noise
    and more discrepancy, so poses would be told apart by where theirs happens to stand. A sky that is less than the
    noise of a pixel hides nothing that is felt.
    """
    most = at.hill.scene.hidden
    if most < at.hill.scene.sigma:
        return start

    def values(shares: list[float]) -> dict[float, float]:
        found = at.log_evidences([at.hill.scene.under(hides=share * most) for share in shares]).max(axis=1)
        return {share: float(value) + _log_prior_of_hidden(share) for share, value in zip(shares, found, strict=True)}

    seen = values([*_HIDDEN] if start.hides is None else [at.hill.scene.share_of_sky(start.hides)])
    for step in _HIDDEN_STEPS:
        here = max(seen, key=lambda share: seen[share])
        seen |= values([share for share in (here - step, here + step) if 0 <= share <= 1 and share not in seen])
    return replace(start, hides=most * max(seen, key=lambda share: seen[share]))


def neighbour(now: Nuisance, turn: int, sky: float) -> Nuisance:
    """One of the five a step further on its grid: the air changes within a pass.

    ``turn`` counts frames; ``sky``: light of it that a body may hide at the most, counts.
    """
    which, there = turn % _FIVE, turn // _FIVE
    if which == 4 and now.hides is not None:
        step = sky * _HIDDEN_STEPS[-1]
        return replace(now, hides=float(np.clip(now.hides + (step if there % 2 else -step), 0.0, sky)))
    if which == 3 and now.photon is not None:
        return replace(now, photon=now.photon * (1 / _PHOTON_STEP if there % 2 else _PHOTON_STEP))
    if which == 2:
        return replace(now, discrepancy=_neighbour(_DISCREPANCIES, now.discrepancy, there))
    spread = now.point_spread(1)
    if which == 1:
        return now.spread_by(spread.width, _neighbour(_SHARES, spread.share, there))
    return now.spread_by(_neighbour(_WIDTHS, spread.width, there), spread.share)


def lets_through(hill: Hill, nuisance: Nuisance) -> bool:
    """Whether the hill's frame could be light that came through such a point spread."""
    return hill.scene.lets_through(nuisance.point_spread(hill.view.binning))


def scene_under(hill: Hill, nuisance: Nuisance) -> Scene:
    """The hill's frame under another nuisance."""
    spread = nuisance.point_spread(hill.view.binning)
    photon = nuisance.photon_on(hill.view.binning)
    return hill.scene.under(point_spread=spread, discrepancy=nuisance.discrepancy, photon=photon, hides=nuisance.hides)


def log_prior(nuisance: Nuisance, hill: Hill) -> float:
    """Of all of it in a frame, but for a constant."""
    out = _log_prior(nuisance) + _log_prior_of_discrepancy(nuisance.discrepancy)
    if nuisance.hides is not None and hill.scene.hidden > 0:
        out += _log_prior_of_hidden(hill.scene.share_of_sky(nuisance.hides))
    photon = nuisance.photon_on(hill.view.binning)
    if photon is None or hill.scene.seen_photon is None:
        return out
    return out + _log_prior_of_photon(photon / hill.scene.seen_photon)


def _neighbour(grid: tuple[float, ...], now: float, turn: int) -> float:
    """The next value of a grid, up or down by turns."""
    k = _nearest(grid, now) + (1 if turn % 2 else -1)
    return grid[min(max(k, 0), len(grid) - 1)]


def _nearest(grid: tuple[float, ...], now: float) -> int:
    return int(np.argmin(np.abs(np.array(grid) - now)))


def _log_prior_of_hidden(share: float) -> float:
    return -0.5 * ((share - prior.HIDDEN_MEAN) / prior.HIDDEN_SIGMA) ** 2


def _log_prior_of_discrepancy(tau: float) -> float:
    deviation = float(np.log(tau / prior.DISCREPANCY)) / prior.DISCREPANCY_LOG_SIGMA
    return -0.5 * deviation**2


def _log_prior_of_photon(share: float) -> float:
    deviation = float(np.log(share / prior.PHOTON_SHARE)) / prior.PHOTON_LOG_SIGMA
    return -0.5 * deviation**2


def _log_prior(nuisance: Nuisance) -> float:
    """Of the point spread."""
    deviation = float(np.log(nuisance.core / prior.CORE_PX)) / prior.CORE_LOG_SIGMA
    optics = -0.5 * deviation**2 - 0.5 * (nuisance.wings / prior.WINGS_SIGMA_PX) ** 2
    return optics - (prior.SHARPENED_NATS if nuisance.sharpened else 0.0)

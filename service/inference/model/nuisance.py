"""What all poses of a frame share: point spread, discrepancy, photon transfer, hidden sky (docs/model.md, 3).

Found at its best poses, then held.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from service.inference.model import prior
from service.inference.model.scene import Scene
from service.inference.model.spread import PointSpread
from service.inference.numerics.hill import Hill, Looked

_WIDTHS = tuple(float(v) for v in 0.4 * 10 ** (np.arange(20) / 11))  # numerical: grid, to 21 px of the frame: enlarged
_SHARES = (0.0, 0.25, 0.5, 0.7, 0.85, 0.95)  # numerical: grid: of the width's square that is the wings'
# numerical: grid, two standard deviations of its log either way, and in wider steps what a wrong mesh may ask for
_LOGS = (*np.linspace(-1.4, 1.4, 13), 1.75, 2.1, 2.45, 2.8)
_DISCREPANCIES = tuple(float(prior.DISCREPANCY * np.exp(v)) for v in _LOGS)
_PHOTON_STEP = 1.41  # numerical: half a standard deviation of its log
_PHOTONS = tuple(float(_PHOTON_STEP**k) for k in range(-6, 3))  # numerical: grid, of what the frame's checkerboard has
_HIDDEN = (0.0, 0.25, 0.5, 0.75, 1.0)  # numerical: grid: share of the most that can be hidden
_HIDDEN_STEPS = (1 / 8, 1 / 16, 1 / 32)  # numerical: by which it is refined
_FIVE = 5  # exact: point spread's width and wings, discrepancy, photons, hidden sky
_LOOKS = 24  # numerical: grids are searched from where one stands: no more than this


@dataclass(frozen=True)
class Nuisance:
    """Of one frame; px of the frame."""

    core: float  # s
    wings: float = 0.0  # w
    discrepancy: float = prior.DISCREPANCY
    photon: float | None = None  # variance per count of light; None: as each frame's finest checkerboard has it
    hides: float | None = None  # counts of the sky's light that the body hides; None: not looked for yet

    def point_spread(self, binning: float) -> PointSpread:
        """On a patch of squares of so many px."""
        return PointSpread(self.core / binning, self.wings / binning)

    def spread_by(self, width: float, share: float) -> Nuisance:
        """The same with a point spread of such a width (px of the frame), of whose square the wings have a share."""
        spread = PointSpread.of(width, share)
        return replace(self, core=spread.core, wings=spread.wings)

    def photon_on(self, binning: float) -> float | None:
        """Variance per count on the same; None: as the frame has it."""
        return None if self.photon is None else self.photon / binning**2


def best_spread(at: Looked, start: Nuisance) -> Nuisance:
    """The point spread under which a few poses explain the frame best, by steps over a grid.

    None through which the frame's own sharpest light could not come: a mesh that is wrong asks for a blur.
    The frame's own low pass stays what the hill has: all are compared on the same data.
    """
    hill = at.hill

    def values(places: list[tuple[int, int]]) -> list[float]:
        tried = [start.spread_by(_WIDTHS[width], _SHARES[share]) for width, share in places]
        scenes = [hill.scene.under(point_spread=one.point_spread(hill.view.binning)) for one in tried]
        found = at.log_evidences(scenes).max(axis=1) + [_log_prior(one.core, one.wings) for one in tried]
        return [float(value) for value in found]

    def possible(place: tuple[int, int]) -> bool:
        width, share = place
        if not (0 <= width < len(_WIDTHS) and 0 <= share < len(_SHARES)):
            return False
        return lets_through(hill, start.spread_by(_WIDTHS[width], _SHARES[share]))

    now = start.point_spread(1)
    here = (
        int(np.argmin(np.abs(np.log(np.array(_WIDTHS) / now.width)))),
        int(np.argmin(np.abs(np.array(_SHARES) - now.share))),
    )
    while here[0] > 0 and not possible(here):
        here = here[0] - 1, here[1]
    seen = {here: values([here])[0]}
    while len(seen) < _LOOKS:
        near = [(here[0] + a, here[1] + b) for a, b in ((1, 0), (-1, 0), (0, 1), (0, -1), (-1, 1), (1, -1))]
        near = [at for at in near if at not in seen and possible(at)]
        if near:
            seen.update(zip(near, values(near), strict=True))
        best = max(seen, key=lambda at: seen[at])
        if best == here:
            break
        here = best
    return start.spread_by(_WIDTHS[here[0]], _SHARES[here[1]])


def best_discrepancy(at: Looked, start: Nuisance) -> Nuisance:
    """The discrepancy under which the best pose explains the frame best, prior included."""
    found = at.log_evidences([at.hill.scene.under(discrepancy=tau) for tau in _DISCREPANCIES]).max(axis=1)
    deviations = np.log(np.array(_DISCREPANCIES) / prior.DISCREPANCY) / prior.DISCREPANCY_LOG_SIGMA
    values = found - 0.5 * deviations**2
    return replace(start, discrepancy=_DISCREPANCIES[int(np.argmax(values))])


def best_photon(at: Looked, start: Nuisance) -> Nuisance:
    """The photon transfer under which the best pose explains the frame best, prior included."""
    scene = at.hill.scene
    seen = scene.photon if scene.seen_photon is None else scene.seen_photon
    found = at.log_evidences([scene.under(photon=seen * share) for share in _PHOTONS]).max(axis=1)
    values = found + [_log_prior_of_photon(share) for share in _PHOTONS]
    return replace(start, photon=seen * _PHOTONS[int(np.argmax(values))] * at.hill.view.binning**2)


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
    """Of all five in a frame, but for a constant."""
    deviation = float(np.log(nuisance.discrepancy / prior.DISCREPANCY)) / prior.DISCREPANCY_LOG_SIGMA
    out = _log_prior(nuisance.core, nuisance.wings) - 0.5 * deviation**2
    if nuisance.hides is not None and hill.scene.hidden > 0:
        out += _log_prior_of_hidden(hill.scene.share_of_sky(nuisance.hides))
    photon = nuisance.photon_on(hill.view.binning)
    if photon is None or hill.scene.seen_photon is None:
        return out
    return out + _log_prior_of_photon(photon / hill.scene.seen_photon)


def _neighbour(grid: tuple[float, ...], now: float, turn: int) -> float:
    """The next value of a grid, up or down by turns."""
    k = int(np.argmin(np.abs(np.array(grid) - now))) + (1 if turn % 2 else -1)
    return grid[min(max(k, 0), len(grid) - 1)]


def _log_prior_of_hidden(share: float) -> float:
    return -0.5 * ((share - prior.HIDDEN_MEAN) / prior.HIDDEN_SIGMA) ** 2


def _log_prior_of_photon(share: float) -> float:
    deviation = float(np.log(share / prior.PHOTON_SHARE)) / prior.PHOTON_LOG_SIGMA
    return -0.5 * deviation**2


def _log_prior(core: float, wings: float) -> float:
    deviation = float(np.log(core / prior.CORE_PX)) / prior.CORE_LOG_SIGMA
    return -0.5 * deviation**2 - 0.5 * (wings / prior.WINGS_SIGMA_PX) ** 2

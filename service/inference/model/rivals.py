"""What might be the truth rather than what is followed: a part of all poses (docs/model.md, section 4)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from service.inference.model.candidates import (
    HOPELESS,
    Candidates,
    best_of,
    best_of_each,
    climbed,
    joined,
    looked_at,
    scored,
    unlike,
)
from service.inference.model.lookalikes import boxed, equivalents
from service.inference.model.nuisance import Nuisance
from service.inference.model.search import BOXED, MORE_SUNS, started, under
from service.inference.model.stages import CLEAR, FINEST, MIDDLE, SHARP, Body, Part, Sight, stage_hill
from service.inference.model.templates import Bank
from service.inference.numerics.gauss_newton import ascend
from service.inference.numerics.hill import Hill, Refined
from service.inference.numerics.priors import PosePrior
from service.inference.state import Poses

_CLIMBING = 24  # numerical: of what is met, what looks like it and what leads, the best that climb


@dataclass(frozen=True)
class Followed:
    """A track ahead of a frame: its modes, the likeliest first, and what they will climb on."""

    modes: Candidates
    sight: Sight
    hill: Hill
    nuisance: Nuisance


class _Known:
    """What is followed, looked at once on each hill."""

    def __init__(self, modes: Candidates) -> None:
        self._modes = modes
        self._last: tuple[Hill, Candidates] | None = None

    def on(self, hill: Hill) -> Candidates:
        """The best first, as a hill has them."""
        if self._last is None or self._last[0] is not hill:
            self._last = hill, scored(hill, self._modes)
        return self._last[1]

    def others_near(self, hill: Hill, some: Candidates) -> Candidates:
        """Those not far behind the best of it, and no other look at any of it."""
        near = some[np.flatnonzero(some.found > self.on(hill).found[0] - HOPELESS)]
        return unlike(near, self._modes.poses, hill.drawing.articulation)


def rivals(
    body: Body,
    followed: Followed,
    bank: Bank,
    told: PosePrior,
    part: Part,
    rng: np.random.Generator,
    alike: Callable[[Poses], Poses] | None = None,
) -> list[Refined]:
    """Basins of a part of all poses that are not far behind the best mode, and no other look at one; best first.

    Air, photons and discrepancy are those that the track has learnt, and it is climbed on what the track climbs on.
    ``alike``: poses whose outline is that of the given ones; light decides between them.
    """
    sight, nuisance, articulation = followed.sight, followed.nuisance, body.fine.articulation

    known = _Known(followed.modes)
    some = started(body, sight, bank, told, nuisance, rng, part, known.others_near)
    boxes = part.number == 0
    for stage in (MIDDLE, SHARP):
        if not len(some) and not boxes:
            return []
        hill = stage_hill(body.middle, sight, stage, nuisance, told, speckle=False)
        some = known.others_near(hill, climbed(hill, scored(hill, some), stage.of(part)))
    if told.towards_sun is None and len(some):  # no climb leads from a Sun in front of a flat body to one behind it
        some = joined([some, under(hill, some, MORE_SUNS)])
    if boxes:
        some = joined([some, boxed(hill, best_of(joined([known.on(hill), some]), BOXED, articulation))])
    some = known.others_near(hill, best_of(some, SHARP.kept, articulation))
    if not len(some):
        return []
    if alike is not None:
        some = joined([some, unlike(equivalents(some, alike), followed.modes.poses, articulation)])
    clear = stage_hill(body.fine, sight, CLEAR, nuisance, told, speckle=True)
    every = joined([some, followed.modes[:1]])
    every = climbed(clear, looked_at(clear, every)[0], replace(CLEAR, kept=_CLIMBING), HOPELESS)
    every = every[np.flatnonzero(every.found > every.found[0] - HOPELESS)]
    some = unlike(every, followed.modes.poses, articulation)
    if not len(some):
        return []
    out = ascend(followed.hill, some.poses, some.suns, steps=FINEST.steps, covariance="last", hopeless=HOPELESS)
    return best_of_each(out, articulation.round_axes)

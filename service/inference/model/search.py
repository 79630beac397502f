"""A frame of which nothing is known: templates, then poses that climb from coarse to fine (docs/model.md, 4)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from service.inference.model import bank as banks
from service.inference.model.candidates import (
    HOPELESS,
    Candidates,
    best_of,
    best_of_each,
    climbed,
    joined,
    looked_at,
    scored,
    searched_joints,
    unlike,
)
from service.inference.model.drawing import Drawing
from service.inference.model.expected import lit_box
from service.inference.model.lookalikes import BETWEEN_JOINTS, boxed, equivalents, scattered
from service.inference.model.nuisance import Nuisance, best_discrepancy, best_hidden, best_photon, best_spread
from service.inference.model.proposing import propose, turns
from service.inference.model.shaking import shaken
from service.inference.model.stages import (
    CLEAR,
    FINEST,
    FIRST,
    MIDDLE,
    ROUGH,
    SHARP,
    WHOLE,
    Body,
    Part,
    Sight,
    stage_hill,
)
from service.inference.model.sun_tracking import SunTracking
from service.inference.model.templates import Bank, directions
from service.inference.numerics.gauss_newton import ascend, stepped
from service.inference.numerics.hill import Hill, Looked, Refined, looked
from service.inference.numerics.priors import PosePrior
from service.inference.pose import concatenate
from service.inference.state import Poses

BANK_SIZE = 4500  # numerical: rotations 12 degrees apart; as many again for each joint, three times at the most
# numerical: about half a step of the bank's, each axis
_BETWEEN_RAD, _BETWEEN_SCALES = 0.07, 0.06
_MIRRORED = 3  # numerical: of the best, whose symmetry-equivalents are looked at
BOXED = 2  # numerical: of the best, whose images were the body a box are looked at
_WIDER = 1.3  # numerical: so much more must a wider sight span
_LIT_SHARE = 0.65  # numerical: of a body's diameter that shows light, as a rule: how far a patch reaches
_TRIED = 60  # numerical: basins whose joints and Suns are tried anew
_TOGETHER = 2  # numerical: joints that are tried in all combinations; more of them one after the other
_VALUES = (8, 6)  # numerical: of each joint, alone or of two together
_SUNS, MORE_SUNS = 14, 48  # numerical: tried roughly, and clearly


@dataclass(frozen=True)
class Found:
    """What a search ends with: basins, best first, on one patch under one point spread and discrepancy."""

    basins: list[Refined]
    hill: Hill
    nuisance: Nuisance  # frame px
    part: Part = WHOLE  # that was searched

    @property
    def candidates(self) -> Candidates:
        """The basins, for another search."""
        poses, suns = concatenate(*[one.pose for one in self.basins]), np.stack([one.sun for one in self.basins])
        return Candidates(poses, suns, np.array([one.log_posterior for one in self.basins]))


@dataclass(frozen=True)
class Track:
    """What is followed already when a search is made."""

    modes: Candidates
    doubted: bool = False  # the best of them does not fit: what lies some degrees about it is searched, too


def search(
    body: Body,
    sight: Sight,
    bank: Bank,
    told: PosePrior,
    wide: Sight | None = None,
    rng: np.random.Generator | None = None,
    alike: Callable[[Poses], Poses] | None = None,
    *,
    shake: bool = True,
    track: Track | None = None,
) -> Found:
    """All that a frame alone says of a pose.

    ``shake``: what lies about the best is looked at in the end, though nothing comes near what is followed already.
    ``track``: what is followed already. Where nothing else comes near to the best of it, nothing is found.
    ``alike``: poses whose outline is that of the given ones; light decides between them.
    ``rng`` moves the templates' poses by half of what lies between them: searches that err do not err alike.
    ``wide``: a sight of more, in case that the body is more than what is seen at one place. The evidence of what both
    propose, on the wider patch, says which of them the search goes on with.
    """
    nuisance = Nuisance(sight.psf)
    if told.log_scale is not None:  # a body that is known to be large may show little of its light at a place
        across = _LIT_SHARE * 2 * body.fine.radius * float(np.exp(told.log_scale))
        sight, wide = replace(sight, span=max(sight.span, across)), None
    some = started(body, sight, bank, told, nuisance, rng)
    if wide is not None and wide.span > _WIDER * sight.span:
        more = started(body, wide, bank, told, nuisance, rng)
        hill = stage_hill(body.middle, wide, MIDDLE, nuisance, told, speckle=False)
        few, others = (climbed(hill, scored(hill, one), MIDDLE) for one in (some, more))
        if len(others) and (not len(few) or others.found[0] > few.found[0]):
            sight, some = wide, others
    if not len(some):
        return Found([], stage_hill(body.fine, sight, FINEST, nuisance, told, speckle=True), nuisance)
    first = some[:1]
    sight = sight.over(lambda lens: lit_box(body.rough, first.poses, first.suns, lens=lens))
    hill = stage_hill(body.middle, sight, MIDDLE, nuisance, told, speckle=False)
    more = 1 + min(1, some.poses.joints.shape[1])
    some = climbed(hill, scored(hill, some), replace(MIDDLE, kept=more * MIDDLE.kept))
    best = looked(hill, some.poses[:3], some.suns[:3])
    nuisance = best_hidden(best, best_spread(best, nuisance))
    hill = stage_hill(body.middle, sight, SHARP, nuisance, told, speckle=False)
    some = climbed(hill, scored(hill, some), SHARP)
    if told.towards_sun is None:  # no climb leads from a Sun in front of a flat body to one behind it
        some = best_of(joined([some, under(hill, some, MORE_SUNS)]), SHARP.kept, body.fine.articulation)
    news = some if track is None else beside(hill, some, track, shake, rng)
    if news is None:
        return Found([], hill, nuisance)
    some = news[np.flatnonzero(news.found > news.found[0] - HOPELESS)]
    some = some if alike is None else joined([some, equivalents(some[:_MIRRORED], alike)])
    return finished(body, sight, some, nuisance, told, shake, track is not None and track.doubted)


def beside(
    hill: Hill, some: Candidates, track: Track, shake: bool, rng: np.random.Generator | None
) -> Candidates | None:
    """What was met, what looks like the best of it, and what is followed; None: nothing that is not followed."""
    articulation = hill.drawing.articulation
    known = climbed(hill, scored(hill, track.modes), SHARP)
    more = [some, boxed(hill, best_of(joined([known, some]), BOXED, articulation))]
    if track.doubted and rng is not None:
        more.append(scattered(rng, hill, known[:1]))
    some = best_of(joined(more), SHARP.kept, articulation)
    rivals = some[np.flatnonzero(some.found > known.found[0] - HOPELESS)]
    if shake or len(unlike(rivals, known.poses, articulation)):
        return best_of(joined([some, known]), SHARP.kept, articulation)
    return None


def started(
    body: Body,
    sight: Sight,
    bank: Bank,
    told: PosePrior,
    nuisance: Nuisance,
    rng: np.random.Generator | None = None,
    part: Part = WHOLE,
    wanted: Callable[[Hill, Candidates], Candidates] | None = None,
) -> Candidates:
    """From templates to the basins of the roughest stage; ``wanted``: those of them that go on."""
    some = propose(bank, sight.cut(sight.span, MIDDLE.wanted), told, part, rng)
    if sight.lens is not None:
        some = replace(some, poses=sight.lens.aimed(some.poses))
    if not len(some):
        return some
    if rng is not None:
        some = jittered(rng, some, body.rough, told.tracking)
    hill = stage_hill(body.rough, sight, ROUGH, nuisance, told, speckle=False)
    some = best_of(scored(hill, some), len(some))
    more = 1 + min(2, some.poses.joints.shape[1])  # joints ask for as many again
    for stage in (FIRST, ROUGH):
        if not len(some):
            break
        some = climbed(hill, varied(hill, some, part), replace(stage, kept=more * stage.kept).of(part))
        some = some if wanted is None else wanted(hill, some)
    return some


def jittered(
    rng: np.random.Generator, some: Candidates, drawing: Drawing, tracking: SunTracking | None = None
) -> Candidates:
    """Each pose somewhere between its neighbours."""
    steps = np.zeros((len(some), 6 + some.poses.joints.shape[1]))
    steps[:, :3] = _BETWEEN_RAD * rng.standard_normal((len(steps), 3))
    steps[:, 5] = _BETWEEN_SCALES * rng.standard_normal(len(steps))
    spans = drawing.articulation.spans
    steps[:, 6:] = BETWEEN_JOINTS * spans * rng.standard_normal((len(steps), len(spans)))
    moved = stepped(drawing, some.poses, steps)
    return replace(some, poses=moved if tracking is None else tracking.pointed(moved, some.suns))


def finished(
    body: Body,
    sight: Sight,
    some: Candidates,
    nuisance: Nuisance,
    told: PosePrior,
    shake: bool = True,
    doubted: bool = False,
) -> Found:
    """The best basins at the finest stage: point spread and discrepancy found at the best of them, then held."""
    some, lead = looked_at(stage_hill(body.fine, sight, CLEAR, nuisance, told, speckle=True), some)
    nuisance = best_spread(lead, nuisance)
    clear = stage_hill(body.fine, sight, CLEAR, nuisance, told, speckle=True)
    some = climbed(clear, some, CLEAR, HOPELESS)
    some, lead = looked_at(stage_hill(body.fine, sight, FINEST, nuisance, told, speckle=True), some)
    some = some[: FINEST.kept]
    hill, nuisance = finest_hill(body, sight, some, lead, nuisance, told)
    given = hill, some.poses, some.suns
    out = ascend(*given, steps=FINEST.steps, covariance="last", hopeless=HOPELESS, start=some.looked)
    out.sort(key=lambda one: -one.log_posterior)
    out = [one for one in out if one.log_posterior > out[0].log_posterior - HOPELESS]
    out += shaken(clear, hill, out[0], doubted) if shake else []
    return Found(best_of_each(out, body.fine.articulation.round_axes), hill, nuisance)


def finest_hill(
    body: Body, sight: Sight, some: Candidates, lead: Looked, nuisance: Nuisance, told: PosePrior
) -> tuple[Hill, Nuisance]:
    """The finest stage under the point spread, discrepancy and photons that explain the frame best at the best of some.

    The discrepancy twice: bright light that is noisy may be either's. The point spread again under what noise there is:
    while all light was thought as noisy as the prior has it, dim edges said little.
    """
    for better in (best_spread, best_hidden, best_discrepancy, best_photon, best_spread, best_discrepancy):
        hill = stage_hill(body.fine, sight, FINEST, nuisance, told, speckle=True)
        lead = lead.on(hill) if lead.is_drawn_on(hill) else looked(hill, some.poses[:1], some.suns[:1])
        nuisance = better(lead, nuisance)
    return stage_hill(body.fine, sight, FINEST, nuisance, told, speckle=True), nuisance


def bank_size(n_joints: int) -> int:
    """Templates that a body of so many joints asks for."""
    return BANK_SIZE * (1 + min(2, n_joints))


def most_parts(body: Body, told: PosePrior) -> int:
    """Into how many parts a search can be cut."""
    count = bank_size(len(searched_joints(body.rough, told)))
    ways = turns(count, told)
    return ways if ways > 1 else count


def make_bank(body: Body, told: PosePrior) -> Bank:
    """Templates under the Sun that is told, or each under one of many."""
    count = bank_size(len(searched_joints(body.rough, told)))
    sun = told.towards_sun
    suns = directions(count) if sun is None else np.tile(sun, (count, 1))
    return banks.build(body.rough, suns, told.tracking, told.light.whole)


def varied(hill: Hill, some: Candidates, part: Part = WHOLE) -> Candidates:
    """What does not move is found first: with other joint values, and other Suns where none is told, it may fit."""
    articulation = hill.drawing.articulation
    some = best_of(some, len(some), articulation)
    tried, joints, free = [some], articulation.joints, searched_joints(hill.drawing, hill.told)
    together = [free] if len(free) <= _TOGETHER else [[k] for k in free]
    for chosen in together if free else ():
        few = best_of(joined(tried), part.share(_TRIED // len(chosen)))
        count = _VALUES[min(len(chosen), len(_VALUES)) - 1]
        for at in np.ndindex(*[count] * len(chosen)):
            values = few.poses.joints.copy()
            for k, place in zip(chosen, at, strict=True):
                values[:, k] = joints[k].minimum + (place + 0.5) / count * (joints[k].maximum - joints[k].minimum)
            tried.append(scored(hill, replace(few, poses=replace(few.poses, joints=values))))
    if hill.told.towards_sun is None:
        tried.append(under(hill, best_of(joined(tried), part.share(_TRIED), articulation), _SUNS))
    return joined(tried)


def under(hill: Hill, some: Candidates, count: int) -> Candidates:
    """The same poses under each of so many Suns, best first."""
    suns = np.repeat(directions(count), len(some), axis=0)
    poses, tracking = some.poses[np.tile(np.arange(len(some)), count)], hill.told.tracking
    if tracking is not None:
        poses = tracking.pointed(poses, suns)
    return scored(hill, Candidates(poses, suns, np.zeros(len(suns))))

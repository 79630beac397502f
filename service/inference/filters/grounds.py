"""What modes climb on in a frame (docs/model.md, section 5)."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from service.inference.filters.given import Given, Predicted
from service.inference.model import prior
from service.inference.model.drawing import Quality
from service.inference.model.expected import lit_box
from service.inference.model.nuisance import Nuisance
from service.inference.model.search import Found
from service.inference.model.stages import Sight, Stage, stage_hill
from service.inference.numerics.hill import Hill, Trust
from service.inference.state import Mixture

FOLLOWED = Stage(80, 0.7, 8, 2, 0.6, Quality(8, 384), Trust())  # numerical: of four samples thin parts are rough
_RIM = 1.2  # numerical: of the body's radius that belongs to it


def ground(
    before: Mixture | None, ahead: Predicted | None, found: Found | None, given: Given
) -> tuple[Hill | None, Nuisance]:
    """What the modes climb on: the search's own patch where there was one, else one around the leader."""
    if found is not None and (found.basins or found.part.count > 1):
        return found.hill, found.nuisance
    if before is None or ahead is None:
        return None, Nuisance(prior.CORE_PX)
    _, hill, nuisance = followed_on(before, ahead, given)
    return hill, nuisance


def followed_on(before: Mixture, ahead: Predicted, given: Given) -> tuple[Sight, Hill, Nuisance]:
    """The light around the leader, what modes climb on there, and under what."""
    lead = int(np.argmax(ahead.log_weights))
    core, wings = (float(one) for one in before.point_spread)
    nuisance = Nuisance(core, wings, before.discrepancy, before.photon, before.hides, before.sharpened, before.mask)
    reach = given.body.fine.radius * float(np.exp(ahead.poses.log_scale[lead]))
    there = replace(ahead.poses, position=ahead.poses.position + ahead.aside)
    sight = given.frame.around(there.position[lead], _RIM * reach, before.span_px, nuisance.core)
    leader = there[lead : lead + 1], ahead.suns[lead : lead + 1], ahead.paint[lead]
    sight = sight.over(lambda lens: lit_box(given.body.fine, *leader, lens=lens))
    return sight, stage_hill(given.body.fine, sight, FOLLOWED, nuisance, given.told, speckle=True), nuisance

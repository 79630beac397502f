"""What looks like a pose, were the body a box."""

from dataclasses import replace

import numpy as np
import pytest
from lit_body import SUN
from lit_search import TOLD, body, off_deg, rough_hill, sight_of, track_at, truth

from service.inference.model.lookalikes import boxed
from service.inference.model.nuisance import Nuisance
from service.inference.model.stages import SHARP, stage_hill
from service.inference.numerics.priors import PosePrior
from service.inference.symmetry import Symmetry, twin

SIGNS = [(x, y, z) for x in (1.0, -1.0) for y in (1.0, -1.0) for z in (1.0, -1.0)][1:]


@pytest.mark.parametrize("signs", SIGNS)
def test_the_truth_is_met_from_what_looks_like_it_were_the_body_a_box(signs):
    at = truth(4, False)
    wrong = twin(at, Symmetry(tuple(tuple(row) for row in np.diag(signs))))
    hill = stage_hill(body(False).middle, sight_of(at), SHARP, Nuisance(1.3), TOLD, speckle=False)
    assert off_deg(wrong, at) > 30.0
    assert off_deg(boxed(hill, track_at(wrong).modes).poses, at)[0] < 3.0


@pytest.mark.parametrize(("told", "flips"), [(TOLD, False), (PosePrior(), True)])
def test_a_sun_that_is_not_told_is_reflected_with_the_body(told, flips):
    at = truth(4, True)
    hill = replace(rough_hill(sight_of(at), told), drawing=body(True).rough)
    looked = boxed(hill, track_at(at).modes)
    assert 0 < len(looked.found) <= 4 and np.isfinite(looked.found).all()
    assert (looked.suns[:, 2] * SUN[2] < 0).any() == flips

"""What poses climb on at a stage, by the size of the body in the image."""

from dataclasses import replace

import pytest
from lit_search import TOLD, body, dark_sight

from service.inference.model import prior
from service.inference.model.nuisance import Nuisance
from service.inference.model.stages import FINEST, stage_hill


@pytest.mark.parametrize("span", [24.0, 40.0, 72.0, 120.0])
@pytest.mark.parametrize("core", [0.6, 2.0])
def test_the_discrepancy_is_alike_over_the_same_share_of_a_body_of_any_size(span, core):
    hill = stage_hill(body(False).fine, replace(dark_sight(), span=span), FINEST, Nuisance(core), TOLD, speckle=True)
    px2 = hill.scene.alike * hill.scene.area * hill.view.binning**2
    least = hill.scene.area * hill.view.binning**2  # what the low pass leaves as one is alike at the least
    assert px2 == pytest.approx(max((prior.DISCREPANCY_LENGTH / FINEST.wanted * span) ** 2, least))

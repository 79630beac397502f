"""What light and shade say decides between basins whose outlines say the same, and never their evidence as a whole."""

from dataclasses import replace

import numpy as np
import pytest

from service.inference.domain import Domain
from service.inference.islands import Islands, strongest
from service.inference.modes import metric_of
from service.inference.params import PriorParams, SessionConfig
from service.inference.pose import exp_so3
from service.inference.search import island_components, shaded
from service.inference.state import Frame, Measurement, Poses
from service.inference.update import Update


@pytest.fixture
def update(block, rigid, quick_score_maps):
    domain = Domain(64, 64, block.radius, rigid, PriorParams())
    frame = Frame(0, 0.0, Measurement(np.full((64, 64), -0.5, np.float32), 0.0))
    return Update(np.random.default_rng(0), None, frame, quick_score_maps, SessionConfig(), domain, ())


def three_islands() -> Islands:
    poses = Poses(
        exp_so3(np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]])), np.full((3, 2), 32.0), np.zeros(3), np.zeros((3, 0))
    )
    return Islands(poses, np.array([100.0, 99.0, 50.0]), poses, np.tile(np.eye(6), (3, 1, 1)), np.zeros(3))


def test_basins_are_ranked_by_outline_and_shading_together(update):
    update = replace(update, shade=lambda poses: np.array([0.1, 0.5, 0.2]))
    islands = shaded(update, three_islands())
    worth = update.config.likelihood.shading_nats
    assert islands.rank == pytest.approx([100 + 0.1 * worth, 99 + 0.5 * worth, 50 + 0.2 * worth])
    assert strongest(islands, metric_of(update.domain.articulation), 1).log_likelihood == pytest.approx([99.0])


def test_a_mode_weighs_by_its_shading_relative_to_the_best(update):
    islands = replace(three_islands(), shading=np.array([10.0, 40.0, 0.0]))
    parts = island_components(update, islands, -1.0)
    exponent = update.config.likelihood.mode_exponent
    assert [p.log_weight for p in parts] == pytest.approx([-1 - np.log(3) + exponent * g for g in (-30, 0, -40)])
    beside = island_components(update, islands, -1.0, beside=25.0)
    assert [p.log_weight for p in beside] == pytest.approx([-1 - np.log(3) + exponent * g for g in (-15, 15, -25)])


def test_switched_off_it_is_never_asked(update):
    def never(poses: Poses) -> np.ndarray:
        raise AssertionError("shading was switched off")

    config = replace(update.config, likelihood=replace(update.config.likelihood, shading_nats=0.0))
    islands = shaded(replace(update, shade=never, config=config), three_islands())
    assert islands.rank == pytest.approx(islands.log_likelihood)

"""Wings of drawn passes have the law that they are said to have, and shares of what was told are counted rightly."""

from dataclasses import dataclass

import numpy as np
import pytest

from service.bench.told_laws import line_of, reliability
from service.bench.tracked_joints import draw_wing, facing_the_sun
from service.simulate.motion import Motion
from service.simulate.scenario import Scenario
from service.simulate.sequence import SimulatedPass


@pytest.fixture
def simulated(satellite):
    scenario = Scenario("", seed=4, motion=Motion(frames=30, frame_interval_s=2.0, rate_deg_s=2.0))
    return SimulatedPass(satellite.mesh, satellite.articulation, scenario)


def wing(simulated):
    names = [joint.name for joint in simulated.articulation.joints]
    return simulated.track.poses.joints[:, names.index("wing")]


def test_a_wing_that_follows_the_sun_keeps_one_side_to_it(simulated):
    offset = draw_wing(np.random.default_rng(2), "sun_tracking", simulated)
    ahead = wing(simulated) - facing_the_sun(simulated, 0)
    np.testing.assert_allclose((ahead - ahead[0] + 90) % 180 - 90, 0, atol=1e-4)
    assert (ahead[0] - offset + 90) % 180 - 90 == pytest.approx(0, abs=1e-4)
    assert np.ptp(np.unwrap(wing(simulated), period=360)) > 20


def test_a_wing_that_stands_still_and_one_that_does_neither(simulated):
    assert draw_wing(np.random.default_rng(2), "neither", simulated) is None
    assert np.ptp(wing(simulated)) > 20
    value = draw_wing(np.random.default_rng(2), "still", simulated)
    np.testing.assert_allclose(wing(simulated), value)


@dataclass(frozen=True)
class Row:
    truth: str
    told: str
    probability: float
    seconds: float = 1.0


def test_shares_of_what_was_told():
    rows = [Row("a", "a", 0.7), Row("a", "b", 0.8), Row("a", "a", 1.0), Row("b", "b", 0.97)]
    line = line_of("law", "all", rows)
    assert (line["law"], line["right"], line["sure"], line["sure_right"]) == ("all", 0.75, 0.5, 1.0)
    bins = {one["from"]: one for one in reliability(rows)}
    assert set(bins) == {0.6, 0.9, 0.99}
    assert bins[0.6] == {"from": 0.6, "to": 0.9, "passes": 2, "told_p": pytest.approx(0.75), "right": 0.5}
    assert bins[0.99]["passes"] == 1

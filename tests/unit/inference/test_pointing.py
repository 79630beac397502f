"""A telescope that was moved: modes go where the frame shows their light, and nowhere else."""

import numpy as np
import pytest
import test_light_filter as lit

from service.inference.filters import mixture as filtering
from service.inference.filters.mixture import predict
from service.inference.filters.pointing import pointed
from service.inference.motion import motion_noise

FRAME = 3
MOVED = np.array([34.0, -31.0])  # px, right and down


def image(k: int, gain: float = 700.0) -> np.ndarray:
    return lit.frame(k, gain)._whole.image.copy()


def moved(by: np.ndarray) -> lit.Drawn:
    return lit.Drawn(np.roll(image(FRAME), by[::-1].astype(int), (0, 1)))


def with_light(light: np.ndarray, counts: float) -> lit.Drawn:
    """Another's, in a corner."""
    light[4:22, 112:140] += counts
    return lit.Drawn(light)


def before():
    return lit.passed()[FRAME - 1][0]


def ahead_of(light: lit.Drawn):
    given = lit.given(light, FRAME)
    ahead = predict(before().mixture, motion_noise(given.config.motion, given.domain), lit.DT_S)
    return ahead, pointed(ahead, before().mixture, given)


def test_where_it_is_expected_nothing_is_asked():
    ahead, seen = ahead_of(lit.frame(FRAME))
    assert seen == (ahead,) and not ahead.aside.any()


@pytest.mark.parametrize("by", [MOVED, -MOVED])
def test_moved_it_is_looked_for_where_light_is_and_may_have_come_from_anywhere(by):
    ahead, (seen, last) = ahead_of(moved(np.round(by)))
    assert last is ahead
    np.testing.assert_allclose(seen.aside, by, atol=4.0)
    np.testing.assert_array_equal(seen.poses.position, ahead.poses.position)
    places = seen.covariance[:, [3, 4], [3, 4]] - ahead.covariance[:, [3, 4], [3, 4]]
    np.testing.assert_allclose(places, lit.SIZE**2 / 12)


def test_a_moved_telescope_costs_no_search(monkeypatch):
    monkeypatch.setattr(filtering, "part_due", lambda *_: None)
    after, estimate = lit.advance(before(), moved(MOVED), FRAME)
    assert estimate.status == "tracking" and lit.error_deg(estimate, FRAME) < 1.0
    np.testing.assert_allclose(estimate.best.position, lit.truth(FRAME).position[0] + MOVED, atol=0.5)
    drift = lit.truth(FRAME).position[0] - lit.truth(FRAME - 1).position[0]
    np.testing.assert_allclose(after.mixture.rates[0, 3:5] * lit.DT_S, drift, atol=3.0)  # it has not learnt a jump


def test_light_elsewhere_is_anothers_while_something_shows_where_the_body_should_be():
    light = with_light(image(FRAME), 3000.0)
    ahead, (seen, _) = ahead_of(light)
    assert seen is ahead
    _, estimate = lit.advance(before(), light, FRAME)
    np.testing.assert_allclose(estimate.best.position, lit.truth(FRAME).position[0], atol=1.0)


def test_light_that_is_not_the_bodys_leaves_it_where_it_was_expected(monkeypatch):
    monkeypatch.setattr(filtering, "part_due", lambda *_: None)
    light = with_light(image(FRAME, gain=0.0), 200.0)
    ahead, (seen, _) = ahead_of(light)
    assert np.hypot(*seen.aside) > 40.0
    after, estimate = lit.advance(before(), light, FRAME)
    assert estimate.status != "tracking"
    assert np.hypot(*(after.mixture.poses.position[0] - ahead.poses.position[0])) < 15.0


def test_a_star_where_the_body_should_be_does_not_hide_where_it_is(monkeypatch):
    monkeypatch.setattr(filtering, "part_due", lambda *_: None)
    light = np.roll(image(FRAME), (60, 50), (0, 1))
    x, y = lit.truth(FRAME).position[0].astype(int)
    light[y - 4 : y, x - 4 : x] += 400.0
    _, (seen, other) = ahead_of(lit.Drawn(light))
    assert not seen.aside.any() and other.aside.any()
    _, estimate = lit.advance(before(), lit.Drawn(light), FRAME)
    assert estimate.status == "tracking" and lit.error_deg(estimate, FRAME) < 1.0

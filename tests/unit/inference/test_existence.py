"""Whether a body is there at all: probabilities held to frames that are drawn from each hypothesis."""

from __future__ import annotations

import functools
from dataclasses import replace

import numpy as np
import pytest
from held_mixture import mixture
from lit_body import QUALITY, SUN, scene, shares
from test_light_filter import SIGMA, SIZE, Drawn, advance, body, given, passed, step, truth

from service.inference.filters.weighing import _REFITTED
from service.inference.model import existence, prior
from service.inference.model.drawing import View
from service.inference.model.spread import PointSpread, spread
from service.inference.numerics.gauss_newton import ascend
from service.inference.numerics.hill import Hill
from service.inference.numerics.priors import PosePrior
from service.inference.pose import retract
from service.inference.state import FilterState, Poses
from service.workers.lit_frame import known_span

FRAMES = 240
ODDS = np.array([0.5, 0.5 - 1e-9, 1e-9])  # absent, fits, no_fit
WIDE = np.array([0.1, 0.1, 0.1, 1.6, 1.6, 0.05])  # what is known of the pose ahead of the frame


def picture(at: Poses, gain: float, albedo=(1.0, 1.4, 0.7)) -> np.ndarray:
    drawing = body().fine
    drawn = drawing.combined(at, SUN, shares(drawing, gain, albedo), View((0.0, 0.0), 1.0, SIZE), QUALITY)
    return spread(drawn, PointSpread(1.3), 0.0)[0]


@functools.cache
def usual_light(gain: float) -> float:
    return float(picture(truth(0), gain).sum())


def told(gain: float, k: int) -> tuple[bool, float]:
    """Whether the body was drawn, as its priors have it, and the probability that it is there."""
    rng = np.random.default_rng([11, k])
    there, image = rng.uniform() < 0.5, np.zeros((SIZE, SIZE))
    if there:
        at = retract(truth(0), WIDE[None] * rng.normal(size=(1, 6)))
        image = picture(at, gain, np.exp(prior.ALBEDO_SIGMA * rng.normal(size=3)))
        image *= usual_light(gain) * np.exp(prior.FADES * rng.normal()) / image.sum()
    known = replace(
        mixture(existence=ODDS),
        poses=truth(0),
        covariance=np.diag(np.concatenate([prior.MEMORY_KEPT * WIDE**2, np.full(6, 1e-4)]))[None],
        log_light=float(np.log(usual_light(gain))),
        point_spread=np.array([1.3, 0.0]),
        span_px=52.0,
    )
    state = FilterState(truth(0), np.zeros(1), np.zeros((1, 6)), 0, 0.0, "tracking", {}, known)
    light = Drawn(image + rng.normal(0, SIGMA, image.shape))
    after, _ = step(rng, state, replace(given(light, 1), time_s=0.0))
    assert after.mixture is not None
    return there, float(after.mixture.existence[existence.FITS])


def test_what_is_told_of_a_faint_body_is_so_often_true():
    """Matched to the drawing it stands five and eight sigma above the noise; half of the frames are empty."""
    rows = np.array([told(gain, k) for gain in (2.0, 3.0) for k in range(FRAMES)])
    there, fits = rows[:, 0] > 0, rows[:, 1]
    sure, doubted, unsure = fits >= 0.9, fits < 0.1, (fits >= 0.1) & (fits < 0.9)
    assert there[sure].mean() >= 0.95 and sure.sum() > 60
    assert there[doubted].mean() <= 0.15 and doubted.sum() > 100
    assert unsure.sum() > 5
    assert -0.15 < fits.mean() - there.mean() < 0.05  # told with some modesty: a spread is that of a Student t


def test_light_that_is_as_it_was_speaks_for_the_body_and_light_that_is_gone_against_it():
    assert existence.log_of_change(None, 5.0) == 0.0
    changes = [existence.log_of_change(5.0, now) for now in (5.0, 5.5, 6.0, 8.0)]
    assert changes == sorted(changes, reverse=True)
    at = np.linspace(-5, 15, 4001)
    density = np.exp([existence.log_of_change(5.0, float(now)) for now in at]) / prior.GAIN_SIGMA
    assert np.isclose(np.trapezoid(density, at), np.sqrt(2 * np.pi))  # the heights of two Gaussians, one over the other


def test_searches_that_find_nothing_better_leave_less_and_less_to_doubt():
    assert [round(existence.missed(n, nats=340), 2) for n in (1, 2, 3, 4)] == [0.2, 0.09, 0.05, 0.03]
    assert existence.missed(3, misses=4, nats=340) > existence.missed(3, nats=340)


def test_what_says_little_more_than_the_empty_sky_is_searched_in_vain():
    doubts = [existence.missed(3, nats=nats) for nats in (-10.0, 50.0, 170.0, 1000.0, np.inf)]
    assert doubts == sorted(doubts, reverse=True)
    assert doubts[1] > 0.5
    assert doubts[3] < 0.01


def test_the_level_of_what_is_left_over_is_learnt_from_frames_that_fit():
    level = existence.usual_chi2()
    for _ in range(12):
        level = existence.usual_chi2(level, 0.3, 0.95)
    assert np.isclose(level[0], np.log(0.3), atol=0.1) and level[1] < 0.1
    assert existence.usual_chi2(level, 30.0, 0.2)[0] == level[0]  # a frame that does not fit teaches nothing
    assert existence.log_of_disturbance(0.3, level) < 0 < existence.log_of_disturbance(12.0, level)


def test_light_that_is_not_the_bodys_is_no_measure_of_it_but_what_was_known_is_slowly_doubted():
    assert existence.usual_light(None, 5.0, 0.1) == existence.usual_light(9.0, 5.0, 0.6) == 5.0
    light = 9.0
    for _ in range(40):
        light = existence.usual_light(light, 5.0, 0.1)
    assert 5.0 < light < 5.1 and existence.usual_light(9.0, 5.0, 0.1) > 8.5


def test_what_a_frame_says_of_another_body_is_not_far_from_what_it_says_with_the_light_fitted_anew():
    """So that it need not be fitted where it is hopeless."""
    for gain, brighter in ((60.0, 1.0), (700.0, 1.0), (700.0, 2.5)):
        image = picture(truth(0), gain, (1.0, 1.4 * brighter, 0.7))
        image = image + np.random.default_rng(5).normal(0, SIGMA, image.shape)
        hill = Hill(scene(image, SIGMA), body().fine, View((0.0, 0.0), 1.0, SIZE), PosePrior(towards_sun=SUN))
        fit = ascend(hill, truth(0), SUN[None].copy(), steps=0, covariance="none")[0].fit
        anew = hill.log_evidences_under(fit.planes, [(existence.scene_unlike(hill), None)])[0, 0]
        assert -_REFITTED < anew - existence.log_unlike_of(hill, fit) < _REFITTED


def test_a_star_alone_is_no_target_where_a_larger_body_was_tracked():
    """With nothing known of the body it may be the body, seen from afar."""
    image = np.random.default_rng(3).normal(0, SIGMA, (SIZE, SIZE))
    image += 60.0 * np.exp(-0.5 * np.sum((np.mgrid[:SIZE, :SIZE].T - (78, 70)) ** 2, axis=2) / 1.3**2)
    state = passed()[2][0]
    after, estimate = advance(state, Drawn(image, known_px=known_span(state)), 3)
    assert known_span(state) > 20 and estimate.status == "no_target" and estimate.probabilities[0] > 0.99
    assert known_span(after) == known_span(state)
    assert advance(None, Drawn(image, known_px=known_span(None)), 0)[1].status != "no_target"


def test_a_body_no_larger_than_a_star_is_followed_however_large_the_patch_it_is_cut_for():
    """The least patch is of 32 px: that says nothing of the body's size, nor is its light a star's."""
    state = None
    for k in range(4):
        spot = replace(truth(k), log_scale=truth(k).log_scale - np.log(7.0))
        image = picture(spot, 900.0) + np.random.default_rng(40 + k).normal(0, SIGMA, (SIZE, SIZE))
        state, estimate = advance(state, Drawn(image, known_px=known_span(state)), k)
        assert estimate.probabilities[0] < 0.01 and known_span(state) < 11, k


def test_the_discrepancy_that_frames_ask_for_tells_a_body_from_another():
    known = existence.log_discrepancy_known
    told = [existence.of_this_body(known(tau)) for tau in (0.005, 0.01, 0.02, 0.03, 0.04, 0.08)]
    assert told == sorted(told, reverse=True)
    assert told[1] > 0.98 and told[2] > 0.9 and 0.2 < told[3] < 0.8 and told[5] < 0.02


def test_frames_that_say_nothing_of_the_discrepancy_tell_no_body_from_another():
    """Where evidence is alike at half and twice of it, the grid's best is chance: the prior's odds are left."""
    flat = existence.log_discrepancy(0.06, (0.0, 0.0))
    assert flat.tolist() == [0.0, 0.0] and existence.of_this_body(flat) == pytest.approx(8 / 9, abs=2e-3)
    weak = existence.log_discrepancy(0.03, (-0.1, -0.1))
    assert existence.of_this_body(existence.log_discrepancy_known(0.03)) < existence.of_this_body(weak) < 8 / 9


def test_the_evidence_of_a_discrepancy_is_that_of_a_normal_law_of_its_log():
    mean, sigma, at = np.log(0.02), 0.4, 0.03
    height = [-0.5 * ((np.log(at * times) - mean) / sigma) ** 2 for times in (1.0, 0.5, 2.0)]
    pull, information = existence.log_discrepancy(at, (height[1] - height[0], height[2] - height[0]))
    assert information == pytest.approx(sigma**-2) and pull / information == pytest.approx(mean)


def test_what_frames_say_of_the_discrepancy_adds_up_and_fades():
    one, other = existence.log_discrepancy_known(0.01), existence.log_discrepancy_known(0.02)
    both = existence.log_discrepancy_so_far(one, other, fits=1.0)
    assert both == pytest.approx(other + prior.MEMORY_KEPT * one)
    assert existence.log_discrepancy_so_far(one, other, fits=0.2) is one  # another's light
    assert existence.log_discrepancy_so_far(None, other, fits=0.2) is other

"""Modes between frames against the textbook Kalman filter, and the hypotheses of a frame."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import beta

from service.inference.model import existence, prior
from service.inference.model.dynamics import corrected, new_born, predicted
from service.inference.motion import MotionNoise
from service.inference.numerics.priors import Believed
from service.inference.state import Poses

D = 3


@pytest.fixture
def noise() -> MotionNoise:
    return MotionNoise(np.array([0.5, 0.2, 0.1]), np.array([0.03, 0.02, 0.01]), np.array([0.2, 0.1, 0.3]))


def spread(seed: int, size: int) -> np.ndarray:
    root = np.random.default_rng(seed).normal(size=(size, size))
    return root @ root.T + 0.1 * np.eye(size)


def test_a_prediction_is_that_of_constant_rates_driven_by_white_noise(noise, monkeypatch):
    monkeypatch.setattr(prior, "MEMORY_KEPT", 1.0)
    before, dt_s = spread(1, 2 * D), 0.7
    onward = np.block([[np.eye(D), dt_s * np.eye(D)], [np.zeros((D, D)), np.eye(D)]])
    jitter, change = np.diag(noise.jitter * dt_s), noise.change
    driven = np.block(
        [
            [np.diag(change * dt_s**3 / 3) + jitter, np.diag(change * dt_s**2 / 2)],
            [np.diag(change * dt_s**2 / 2), np.diag(change * dt_s)],
        ]
    )
    assert predicted(before, noise, dt_s) == pytest.approx(onward @ before @ onward.T + driven)


def test_what_is_remembered_fades(noise):
    still = MotionNoise(noise.variance, np.zeros(D), np.zeros(D))
    before = spread(2, 2 * D)
    assert predicted(before, still, 0.0) == pytest.approx(before / prior.MEMORY_KEPT)
    assert predicted(before, still, 0.0, seen=False) == pytest.approx(before)  # the next frame repeats nothing


def test_a_correction_is_the_kalman_filters():
    """A measurement of the pose with covariance M: the joint Gaussian, conditioned."""
    before, measured, seen = spread(3, 2 * D), spread(4, D), np.array([0.3, -0.2, 0.5])
    gain = before[:, :D] @ np.linalg.inv(before[:D, :D] + measured)
    after = before - gain @ before[:D, :]
    rates = np.array([1.0, 2.0, 3.0])
    found, covariance = corrected(rates, before, (gain @ seen)[:D], after[:D, :D])
    assert found == pytest.approx(rates + (gain @ seen)[D:])
    assert covariance == pytest.approx(after)


def test_a_mode_is_born_with_rates_of_which_nothing_is_known(noise):
    found = new_born(spread(5, D), noise)
    assert np.diag(found)[D:] == pytest.approx(noise.variance)
    assert not found[:D, D:].any()


def test_existence_forgets():
    seen = np.array([0.0, 1.0, 0.0])
    assert existence.expected(seen, 0.0) == pytest.approx(seen)
    assert existence.expected(seen, 1e4) == pytest.approx(prior.EXISTENCE)
    assert existence.expected(None, 1.0) == pytest.approx(prior.EXISTENCE)
    assert existence.expected(seen, 3.0).sum() == pytest.approx(1.0)


@pytest.mark.parametrize(("searches", "misses"), [(0, 0), (1, 0), (2, 0), (5, 0), (2, 1), (3, 4)])
def test_the_truth_is_missed_as_often_as_the_beta_law_says(searches, misses):
    """What searches have missed before is part of the law: here by weights."""
    half = 0.5 * prior.SEARCH_WEIGHT
    finds = beta(half, half).rvs(400_000, random_state=searches)
    weight = (1 - finds) ** misses
    wanted = np.sum(weight * (1 - finds) ** searches) / np.sum(weight)
    assert existence.missed(searches, misses, nats=prior.SEARCH_HALF) == pytest.approx(wanted, abs=5e-3)


def test_a_joint_that_turns_all_the_way_is_expected_the_short_way_round():
    def panel(value: float) -> Poses:
        return Poses(np.array([[1.0, 0.0, 0.0, 0.0]]), np.zeros((1, 2)), np.zeros(1), np.array([[value]]))

    first = np.zeros(1, dtype=np.intp)
    nothing = np.zeros((1, 2, 6)), np.array([[0.0, 0.0, -1.0]]), np.ones(1)
    turning, stopped = (Believed(panel(179.0), np.eye(7)[None], np.array([wraps]), *nothing) for wraps in (True, False))
    assert turning.log_density(panel(-179.0), first) == pytest.approx(-2.0)
    assert stopped.log_density(panel(-179.0), first) == pytest.approx(-0.5 * 358**2)


def left_over(values) -> np.ndarray:
    """The usual level after frames of a body that fits."""
    level = existence.usual_chi2()
    for chi2 in values:
        level = existence.usual_chi2(level, chi2, 1.0)
    return level


def test_a_body_that_left_little_over_is_disturbed_by_what_is_usual_for_another():
    """Sevenfold is a cloud where frames scatter by a third; where so much is usual, it says nothing."""
    clean, rough = (left_over([level * f for f in (1.0, 1.3, 0.8, 1.1)]) for level in (0.3, 2.1))
    assert existence.log_of_disturbance(2.1, clean) > 1.5
    assert existence.log_of_disturbance(2.1, rough) < 0.5
    assert existence.log_of_disturbance(0.35, clean) < -1.0
    ratios = [existence.log_of_disturbance(chi2, clean) for chi2 in (0.0, 0.5, 2.0, 10.0, 50.0, 1e6)]
    assert ratios == sorted(ratios)


def test_a_level_is_learnt_from_frames_that_fit_and_outliers_move_it_little():
    level = left_over([0.3] * 6)
    assert np.exp(level[0]) == pytest.approx(0.3, rel=0.2) and level[1] < 0.1
    assert existence.usual_chi2(level, 9.0, 0.1)[0] == level[0]
    moved = existence.usual_chi2(level, 9.0, 0.9)[0] - level[0]
    assert 0 < moved < 0.1

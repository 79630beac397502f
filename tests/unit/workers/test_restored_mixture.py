"""A checkpoint's modes: what the tracker would stumble over is refused."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from service.inference.state import Clutter, Displaced, FilterState, Mixture, Poses
from service.workers.codec import encode
from service.workers.restoring import check_state

MIXTURE = Mixture(
    poses=Poses(np.array([[1.0, 0, 0, 0]]), np.full((1, 2), 50.0), np.zeros(1), np.zeros((1, 1))),
    rates=np.zeros((1, 7)),
    covariance=np.eye(14)[None],
    suns=np.array([[0.0, 0.0, -1.0]]),
    sun_sigmas=np.full(1, 0.0175),
    paint=np.zeros((1, 2, 6)),
    log_weights=np.zeros(1),
    existence=np.array([0.0, 0.9, 0.1]),
    point_spread=np.array([1.2, 0.0]),
    discrepancy=0.04,
    log_chi2=np.array([-0.2, 1.2]),
    log_light=8.0,
    span_px=40.0,
    ever_tracked=True,
    searches=3,
    misses=0,
    since_search=1,
)


def state(mixture: Mixture) -> FilterState:
    poses = Poses(np.array([[1.0, 0, 0, 0]]), np.full((1, 2), 50.0), np.zeros(1), np.zeros((1, 1)))
    return FilterState(poses, np.zeros(1), np.zeros((1, 7)), 4, 0.4, "tracking", {}, mixture)


def test_modes_as_the_filter_keeps_them_are_taken():
    check_state(state(MIXTURE), 1)


def test_particles_that_are_only_looked_at_are_kept_small_and_taken():
    many = FilterState(
        Poses(*(np.repeat(part, 500, axis=0) for part in vars(state(MIXTURE).poses).values())),
        np.full(500, -np.log(500)),
        np.zeros((500, 7)),
        *(4, 0.4, "tracking", {}, MIXTURE),
    )
    shown = many.to_show()
    assert len(encode(shown)) < 0.4 * len(encode(many))
    assert np.array_equal(shown.poses.position, many.poses.position) and shown.mixture is MIXTURE
    check_state(shown, 1, resampled=False)
    check_state(many, 1, resampled=False)  # of a release before
    with pytest.raises(ValueError, match="float64"):
        check_state(shown, 1)  # of the published filter: its next particles are drawn from these


@pytest.mark.parametrize(
    "broken",
    [
        {"rates": np.zeros((1, 6))},
        {"rates": np.full((1, 7), np.nan)},
        {"covariance": np.zeros((1, 14, 14))},
        {"covariance": -np.eye(14)[None]},
        {"suns": np.array([[0.0, 0.0, -2.0]])},
        {"paint": np.zeros((1, 6))},
        {"paint": np.full((1, 2, 6), np.nan)},
        {"paint": np.full((1, 2, 6), -1.0)},
        {"sun_sigmas": np.zeros(1)},
        {"log_chi2": np.array([0.0, -1.0])},
        {"log_discrepancy": np.array([0.0, -1.0])},
        {"log_discrepancy": np.array([np.nan, 1.0])},
        {"log_discrepancy": np.zeros(3)},
        {"misses": -1},
        {"log_weights": np.array([-3.0])},
        {"existence": np.array([-0.5, 1.0, 0.5])},
        {"existence": np.array([0.5, 0.9, 0.1])},
        {"point_spread": np.array([0.0, 0.0])},
        {"point_spread": np.array([1.0, -1.0])},
        {"discrepancy": 0.0},
        {"discrepancy": float("nan")},
        {"log_light": float("inf")},
        {"span_px": 0.0},
        {"photon": 0.0},
        {"sharpened": -0.5},
        {"mask": float("nan")},
        {"span_px": 1e9},
        {"searches": -1},
        {"since_search": 0.5},
        {"ever_tracked": 1},
        {"answered": 1.5},
    ],
)
def test_modes_that_are_none_are_refused(broken):
    with pytest.raises(ValueError, match="mixture"):
        check_state(state(replace(MIXTURE, **broken)), 1)


@pytest.mark.parametrize(
    ("probability", "pose", "rates"),
    [
        (1.0, {}, np.zeros((1, 7))),
        (float("nan"), {}, np.zeros((1, 7))),
        (0.5, {}, np.zeros((1, 6))),
        (0.5, {}, np.full((1, 7), np.nan)),
        (0.5, {"quaternion": np.zeros((1, 4))}, np.zeros((1, 7))),
        (0.5, {"position": np.full((1, 2), np.inf)}, np.zeros((1, 7))),
    ],
)
def test_an_answer_that_was_displaced_is_one(probability, pose, rates):
    check_state(state(replace(MIXTURE, displaced=Displaced(0.5, MIXTURE.poses, np.zeros((1, 7))))), 1)
    held = Displaced(probability, replace(MIXTURE.poses, **pose), rates)
    with pytest.raises(ValueError, match="displaced"):
        check_state(state(replace(MIXTURE, displaced=held)), 1)


@pytest.mark.parametrize(
    "broken",
    [
        {"covariance": -np.eye(14)[None]},
        {"covariance": np.eye(12)[None]},
        {"paint": np.zeros((1, 2, 5))},
        {"suns": np.zeros((1, 3))},
        {"sun_sigmas": np.full(1, np.nan)},
        {"searches": -1},
        {"misses": 1.0},
        {"searched_nats": np.inf},
        {"discrepancy": 0.0},
    ],
)
def test_what_is_remembered_of_it_is_a_mode(broken):
    held = Displaced(0.5, MIXTURE.poses, np.zeros((1, 7)), MIXTURE)
    check_state(state(replace(MIXTURE, displaced=held)), 1)
    with pytest.raises(ValueError, match=r"displaced|mixture"):
        check_state(state(replace(MIXTURE, displaced=replace(held, was=replace(MIXTURE, **broken)))), 1)


def test_nothing_is_remembered_of_what_was_displaced_before():
    held = Displaced(0.5, MIXTURE.poses, np.zeros((1, 7)), MIXTURE)
    twice = replace(held, was=replace(MIXTURE, displaced=held))
    with pytest.raises(ValueError, match="displaced"):
        check_state(state(replace(MIXTURE, displaced=twice)), 1)


CLUTTER = Clutter(
    np.full(256, -5.0, np.float32),
    np.full(256, -6.0, np.float32),
    0.0,
    255.0,
    np.zeros((40, 40), np.uint8),
    np.zeros(2),
)


def test_clutter_as_the_filter_keeps_it_is_taken():
    check_state(replace(state(MIXTURE), clutter=CLUTTER), 1)


@pytest.mark.parametrize(
    "broken",
    [
        {"body": np.full(255, -5.0, np.float32)},
        {"body": np.full(4096, -5.0, np.float32)},
        {"clutter": np.full(256, np.nan, np.float32)},
        {"clutter": np.full(256, -5.0)},
        {"span": 0.0},
        {"low": float("nan")},
        {"picture": np.zeros((40, 39), np.uint8)},
        {"picture": np.zeros((40, 40))},
        {"corner": np.array([0.0, np.inf])},
    ],
)
def test_other_clutter_is_refused(broken):
    with pytest.raises(ValueError):
        check_state(replace(state(MIXTURE), clutter=replace(CLUTTER, **broken)), 1)

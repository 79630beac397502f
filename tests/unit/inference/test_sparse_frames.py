"""Frames far apart: a body turns far between them, at a rate that is not known yet (docs/model.md, 5 and 6)."""

from __future__ import annotations

import functools
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import test_light_filter as lit
from held_mixture import HELD, mixture
from test_displaced import GIVEN, HALF_TURN, predicted, turned

from service.inference.articulation import Articulation, Joint
from service.inference.domain import Domain
from service.inference.filters.births import turned_from
from service.inference.filters.given import Predicted
from service.inference.model import existence, paint, prior
from service.inference.model.dynamics import turn
from service.inference.params import PriorParams
from service.inference.state import Mixture, Poses

EVERY = 20  # of the frames of test_light_filter: one in two seconds, 29 degrees apart


def expected(deg: float, weights: tuple[float, ...] = (1.0,)) -> Predicted:
    """Modes whose prediction is known to so many degrees about each axis."""
    ahead = predicted(mixture(weights))
    wide = np.zeros((len(weights), 12, 12)) + np.diag(np.r_[np.full(3, np.deg2rad(deg) ** 2), np.ones(9)])
    return replace(ahead, covariance=wide)


def test_a_mode_has_turned_as_far_as_its_rate_may_bring_it():
    near, far = turned(np.deg2rad(20.0)), turned(np.deg2rad(60.0), about=1)
    assert turned_from(near, expected(25.0), GIVEN)[1] == 0  # of one frame a second: nothing is known of its rate
    assert turned_from(near, expected(0.5), GIVEN) is None  # the rate is known: it was no mode
    assert turned_from(far, expected(25.0), GIVEN) is not None
    assert turned_from(far, expected(5.0), GIVEN) is None
    assert turned_from(turned(np.pi), expected(1e4), GIVEN) is not None  # not seen for minutes: it may be turned anyhow


def test_it_has_turned_to_any_pose_that_cannot_be_told_from_the_one_that_was_met():
    given = SimpleNamespace(twins=(HALF_TURN,), domain=GIVEN.domain)
    assert turned_from(turned(np.pi), expected(1.0), GIVEN) is None
    pose, mode = turned_from(turned(np.pi), expected(1.0), given)
    assert mode == 0 and np.abs(pose.quaternion @ HELD.quaternion[0]) == pytest.approx(1.0)


def test_joints_turn_as_far_as_their_rates_may_bring_them():
    hinge = Joint("hinge", "revolute", -90.0, 90.0, 0.0, ())
    domain = Domain(144, 144, 1.0, Articulation((), (hinge,)), PriorParams())
    ahead, given = expected(2.5), SimpleNamespace(twins=(), domain=domain)
    wide = np.diag(np.r_[np.full(3, 2e-3), np.ones(3), 3.0**2, np.ones(7)])[None]  # 3 degrees
    held = Poses(HELD.quaternion, HELD.position, HELD.log_scale, np.zeros((1, 1)))
    ahead = replace(ahead, poses=held, rates=np.zeros((1, 7)), covariance=wide)
    there = [replace(held, joints=np.array([[joint]])) for joint in (8.0, 60.0)]
    assert [turned_from(pose, ahead, given) is not None for pose in there] == [True, False]


def test_an_unlikely_mode_has_turned_nowhere():
    near = turned(np.deg2rad(9.0))
    assert turned_from(near, expected(2.5), GIVEN) is not None
    assert turned_from(near, expected(2.5, (1e-6, 1 - 1e-6)), GIVEN) is None


def test_paint_wears_off_as_a_body_turns_but_no_more_gets_unknown_than_of_any():
    known = np.stack([np.zeros((1, 4)), np.full((1, 4), 400.0)], axis=1)

    def variance(turn: float) -> np.ndarray:
        return 1 / paint.expected(known, np.array([turn]))[0, 1] - 1 / 400.0

    assert variance(0.0) == pytest.approx(np.full(4, prior.PAINT_DRIFT**2))
    assert variance(0.2) - variance(0.0) == pytest.approx(np.full(4, (prior.PAINT_TURN * 0.2**2) ** 2))
    assert variance(3.0) - variance(0.0) == pytest.approx(np.full(4, prior.ALBEDO_SIGMA**2))


def test_a_body_turns_by_what_is_known_of_its_rates():
    rates, covariance = np.array([[0.3, 0.0, 0.4, 9.0, 9.0, 9.0]]), np.zeros((1, 12, 12))
    assert turn(rates, covariance, 2.0) == pytest.approx([1.0])
    covariance[0, 6:9, 6:9] = 0.03 * np.eye(3)
    assert turn(rates, covariance, 1.0) == pytest.approx([0.4])
    covariance[0, 6:9, 6:9] = np.eye(3)
    assert turn(rates, covariance, 1.0) == pytest.approx([0.0])  # noise


@functools.cache
def followed() -> tuple[tuple[Mixture, str, float], ...]:
    state, out = None, []
    for k in range(0, 5 * EVERY, EVERY):
        state, estimate = lit.advance(state, lit.frame(k), k)
        out.append((state.mixture, estimate.status, lit.error_deg(estimate, k)))
    return tuple(out)


def test_a_frame_in_two_seconds_is_enough_to_follow_a_body_and_learn_its_rate():
    assert [error < 3.0 for _, _, error in followed()] == [True] * 5
    assert [status for _, status, _ in followed()] == ["tracking"] * 5
    last = followed()[-1][0]
    assert last.misses == 0 and last.searches >= 2  # no search has missed what only turned
    assert last.existence[existence.FITS] > 0.9
    deviation = np.sqrt(np.diag(last.covariance[int(np.argmax(last.log_weights))])[6:9])
    rates = last.rates[int(np.argmax(last.log_weights)), :3]
    assert np.abs(rates - lit.RATE[0, :3]).max() < 4 * deviation.max() < 0.5

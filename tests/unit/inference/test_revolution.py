"""Bodies of revolution: what is left of two attitudes, and of a spread, when the turn about an axis may be any."""

import numpy as np
import pytest
from held_mixture import HELD, mixture
from scipy.spatial.transform import Rotation

from service.inference.articulation import Articulation
from service.inference.domain import Domain
from service.inference.filters.answer import drawn, estimate_of
from service.inference.filters.status import status_of, told_existence
from service.inference.model.candidates import distinct, turned_alike
from service.inference.params import PriorParams
from service.inference.pose import angle_between, exp_so3, log_so3, multiply
from service.inference.revolution import angle_apart, turned_freely, turned_round, turned_within, with_free_turn
from service.inference.state import Poses

AXIS = (0.6, 0.0, 0.8)
BALL = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
STILL = np.array([[1.0, 0.0, 0.0, 0.0]])


def any_turns(n: int, seed: int) -> np.ndarray:
    return Rotation.random(n, random_state=seed).as_quat(scalar_first=True)


def test_the_angle_apart_is_the_least_over_all_turns_about_the_axis():
    a, b = any_turns(20, 0), any_turns(20, 1)
    turns = exp_so3(np.linspace(0, 2 * np.pi, 3601)[:, None] * np.array(AXIS))
    least = angle_between(multiply(a[:, None], turns[None]), b[:, None]).min(axis=1)
    assert angle_apart(a, b, (AXIS,)) == pytest.approx(least, abs=1e-3)
    assert angle_apart(a, b, ()) == pytest.approx(angle_between(a, b))
    assert not angle_apart(a[:, None], b[None], BALL).any()


@pytest.mark.parametrize("axes", [(), (AXIS,), BALL])
def test_those_within_an_angle_are_those_whose_angle_apart_is_less(axes):
    some = any_turns(30, 2)
    apart = angle_apart(some[:, None], some[None], axes)
    assert np.array_equal(turned_within(some, 0.7, axes), apart <= 0.7)


def test_poses_that_only_turn_a_round_body_about_its_axis_are_one_basin_and_one_look():
    turns = np.deg2rad([0.0, 3.0, 60.0, 180.0])[:, None]
    about = Poses(exp_so3(turns * np.array(AXIS)), np.zeros((4, 2)), np.zeros(4), np.zeros((4, 0)))
    assert distinct(about, np.deg2rad(5.0)).tolist() == [0, 2, 3]
    assert distinct(about, np.deg2rad(5.0), axes=(AXIS,)).tolist() == [0]
    assert distinct(about, np.deg2rad(5.0), axes=((0.8, 0.0, -0.6),)).tolist() == [0, 2, 3]
    body = Articulation((), round_axes=(AXIS,))
    assert distinct(about, np.deg2rad(5.0), body).tolist() == [0]
    assert turned_alike(about[:1], about, body).tolist() == [True] * 4
    assert turned_alike(about[:1], about, Articulation(())).tolist() == [True, True, False, False]


@pytest.mark.parametrize("axes", [(AXIS,), BALL])
def test_what_is_drawn_has_the_spread_that_is_told(axes):
    drawn = log_so3(turned_freely(np.random.default_rng(0), np.tile(STILL, (40_000, 1)), axes))
    told = with_free_turn(np.zeros((3, 3)), axes)
    np.testing.assert_allclose(drawn.T @ drawn / len(drawn), told, atol=0.03)
    even = turned_round(Poses(STILL, np.zeros((1, 2)), np.zeros(1), np.zeros((1, 0))), axes)
    mean_square = float(np.mean(np.sum(log_so3(even.quaternion) ** 2, axis=1)))
    assert mean_square == pytest.approx(float(np.trace(told)), rel=0.15)


def test_what_is_known_across_the_axis_and_of_the_place_stays():
    covariance = np.diag([1e-4, 2e-4, 3e-4, 0.5, 0.6])
    told = with_free_turn(covariance, ((0.0, 0.0, 1.0),))
    np.testing.assert_allclose(told, np.diag([1e-4, 2e-4, np.pi**2 / 3, 0.5, 0.6]))
    assert with_free_turn(covariance, ()) is covariance


def test_modes_that_differ_by_the_turn_alone_are_one_answer_which_tells_it_as_unknown():
    axis = (1.0, 0.0, 0.0)  # about which the modes are a radian apart
    domain = Domain(144, 144, 1.0, Articulation(("body",), round_axes=(axis,)), PriorParams())
    held = mixture((0.7, 0.3))
    assert status_of(held, (), domain) == "tracking"
    poses, _ = drawn(np.random.default_rng(0), held, 1000, domain)
    told = estimate_of(held, poses, "tracking", domain, told_existence(held), (0.0, 0.0), None)
    assert told.spread.orientation_deg == pytest.approx(180 / np.sqrt(3), rel=0.01)
    assert told.spread.covariance[0, 0] == pytest.approx(180**2 / 3) and told.spread.covariance[1, 1] < 2
    assert told.spread_all.orientation_deg == pytest.approx(180 / np.sqrt(3), rel=0.05)
    assert np.rad2deg(angle_apart(poses.quaternion, HELD.quaternion, (axis,))).max() < 15

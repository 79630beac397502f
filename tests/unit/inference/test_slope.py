"""What light and shade say near one pose, as every particle is asked."""

import dataclasses

import numpy as np
import pytest

from service.inference.articulation import Articulation
from service.inference.modes import metric_of
from service.inference.pose import retract
from service.inference.proposal import Adapted, Component, Proposal, adapt
from service.inference.shaded import narrowed, shade
from service.inference.slope import Slope, sloped
from service.inference.state import Poses

METRIC = metric_of(Articulation(("bus",)))
ORIGIN = Poses(np.array([[1.0, 0, 0, 0]]), np.array([[30.0, 20.0]]), np.array([1.0]), np.zeros((1, 0)))
CURVATURE = np.diag([400.0, 100.0, 0.0, 4.0, 1.0, 900.0])
LEAST = np.array([0.02, -0.03, 0.0, 0.5, -1.0, 0.01])
SLOPE = Slope(ORIGIN, CURVATURE @ LEAST, CURVATURE, 500.0)
X = np.random.default_rng(1).standard_normal((50, 6)) * np.array([0.05, 0.05, 0.05, 1, 1, 0.03])


def test_it_is_nought_at_its_best_pose_and_less_elsewhere():
    assert SLOPE(retract(ORIGIN, LEAST[None])) == pytest.approx([0.0], abs=1e-9)
    assert np.all(SLOPE(retract(ORIGIN, X)) < 0)


def test_its_gradient_and_curvature_are_those_it_was_made_from():
    small = 1e-4
    ends = np.array([SLOPE(retract(ORIGIN, sign * small * np.eye(6))) for sign in (1, -1)])
    least = Slope(ORIGIN, CURVATURE @ LEAST, CURVATURE, 1e9)  # without the log, exact
    exact = np.array([least(retract(ORIGIN, sign * small * np.eye(6))) for sign in (1, -1)])
    assert (exact[0] - exact[1]) / (2 * small) == pytest.approx(CURVATURE @ LEAST, abs=1e-3)
    assert (ends[0] - ends[1]) / (2 * small) == pytest.approx(CURVATURE @ LEAST, rel=0.01, abs=1e-3)


def test_far_away_it_falls_like_a_log_only():
    far = np.zeros((2, 6))
    far[:, 4] = (1e3, 1e6)
    near, further = SLOPE(retract(ORIGIN, far))
    assert near - further == pytest.approx(2 * SLOPE.nats * np.log(1e3), rel=0.01)


def test_each_pose_listens_to_the_slope_of_its_own_mode():
    turned = retract(ORIGIN, np.array([[0.0, 0, 2.0, 0, 0, 0]]))
    other = dataclasses.replace(SLOPE, pose=turned, gradient=np.zeros(6))
    poses = retract(ORIGIN, np.array([[0, 0, 0.0, 0, 0, 0], [0, 0, 2.01, 0, 0, 0], [0, 0, 1.0, 0, 0, 0]], float))
    said = sloped([SLOPE, other], poses, METRIC)
    assert said[0] == SLOPE(poses[:1])[0] and said[1] == other(poses[1:2])[0]
    assert said[2] == 0.0  # in neither mode
    assert sloped([], poses, METRIC) == pytest.approx(0.0)


def test_units_do_not_decide_what_is_known():
    """A joint in degrees has a curvature millions of times less than a rotation in radians, and is known as well."""
    unit = np.array([1.0, 1.0, 1.0, 1e3, 1e3, 1e-2])
    other = Slope(ORIGIN, CURVATURE @ LEAST / unit, CURVATURE / np.outer(unit, unit), 500.0)
    assert other.least == pytest.approx(LEAST * unit, abs=1e-9)


def test_knowing_more_narrows_a_covariance_of_any_shape():
    """As inverses would, where those can be taken; where they cannot (many joints), still a covariance."""
    rng = np.random.default_rng(5)
    for d, decades in ((6, 2.0), (20, 16.0)):
        turn, _ = np.linalg.qr(rng.standard_normal((d, d)))
        factor = np.linalg.qr((turn * 10 ** (decades * (rng.random(d) - 0.5))).T, mode="r").T
        more = rng.standard_normal((d, d))
        information = more @ more.T
        found = narrowed(factor, information)
        assert np.all(np.diag(found) > 0) and np.all(np.triu(found, 1) == 0)
        if decades < 8:
            expected = np.linalg.inv(np.linalg.inv(factor @ factor.T) + information)
            assert found @ found.T == pytest.approx(expected, rel=1e-6, abs=1e-9)


def part(log_weight: float = 0.0, mean: Poses = ORIGIN) -> Component:
    deviation = np.array([0.05, 0.05, 0.05, 1, 1, 0.03])
    return Component(log_weight, mean, np.diag(deviation**2), np.zeros(6), np.zeros((6, 6)), np.eye(6))


def flat(poses: Poses) -> np.ndarray:
    return np.zeros(len(poses))


def test_a_mode_moves_to_where_prediction_and_brightness_agree():
    """Both Gaussian, and an outline that says nothing: the product is known."""
    rng, exponent = np.random.default_rng(2), 0.5
    sharp = dataclasses.replace(SLOPE, nats=1e9)
    before = adapt(rng, part(), flat, exponent)
    (shaded,), (found,) = shade(rng, [part()], [before], flat, exponent, exponent, lambda _: sharp)
    precision = np.linalg.inv(part().covariance) + exponent * CURVATURE
    mean = np.linalg.solve(precision, exponent * CURVATURE @ LEAST)
    spread = np.sqrt(np.diag(np.linalg.inv(precision)))
    assert shaded.slope is sharp
    assert np.abs((found.proposal.mean - mean) / spread).max() < 0.5
    closed = -0.5 * np.linalg.slogdet(part().covariance @ precision)[1]
    closed += 0.5 * mean @ precision @ mean - 0.5 * exponent * LEAST @ CURVATURE @ LEAST
    assert found.log_evidence == pytest.approx(closed, abs=0.25)


def test_light_modes_are_left_to_their_outlines():
    proposal = Adapted(Proposal(np.zeros(6), np.eye(6)), 0.0, 0.0)
    asked: list[Poses] = []

    def slope_at(pose: Poses) -> Slope | None:
        asked.append(pose)
        return None

    parts = [part(0.0), part(-6.0)]
    same, _ = shade(np.random.default_rng(3), parts, [proposal, proposal], flat, 0.1, 0.1, slope_at)
    assert len(asked) == 1 and [p.slope for p in same] == [None, None]

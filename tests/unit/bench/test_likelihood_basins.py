"""Which basin is the truth's, which its twin's, by how much it wins: on poses and numbers made by hand."""

import numpy as np
import pytest

from service.bench.likelihood_basins import REGION_50, REGION_90, Likeness, margin, squared_deviation, twin_margin
from service.inference.articulation import hold
from service.inference.model.prior import POSE_DEGREES_OF_FREEDOM
from service.inference.numerics.student import draw
from service.inference.pose import concatenate, from_matrices, multiply, retract, rotation_matrices
from service.inference.state import Poses

DEPTH = np.diag([1.0, 1.0, -1.0])
MIRROR = np.diag([1.0, -1.0, 1.0])
HALF_TURN = np.diag([-1.0, -1.0, 1.0])


@pytest.fixture
def likeness_of(case_of, block, truth):
    def make(*symmetries):
        held = hold(block.articulation, (), {})
        return Likeness.of(case_of(block, (), symmetries), held, truth.poses(held))

    return make


def turned(pose: Poses, degrees: float) -> Poses:
    step = np.zeros((1, 6 + pose.joints.shape[1]))
    step[0, 1] = np.deg2rad(degrees)
    return retract(pose, step)


def test_a_rotation_symmetry_is_the_truth_and_a_mirror_twin_is_not(likeness_of):
    likeness = likeness_of(HALF_TURN, MIRROR)
    true = likeness.truths[:1]
    half = Poses(multiply(true.quaternion, from_matrices(HALF_TURN)), true.position, true.log_scale, true.joints)
    seen = concatenate(true, turned(half, 3.0), likeness.twins)
    np.testing.assert_allclose(likeness.errors_deg(seen)[:2], [0.0, 3.0], atol=1e-6)
    assert likeness.errors_deg(seen)[2] > 20
    matrix = rotation_matrices(true.quaternion)[0]
    np.testing.assert_allclose(rotation_matrices(likeness.twins.quaternion)[0], DEPTH @ matrix @ MIRROR, atol=1e-9)
    np.testing.assert_array_equal(likeness.twins.position, true.position)


def test_the_right_twin_is_told_only_where_a_twin_or_the_truth_is_found(likeness_of):
    likeness = likeness_of(MIRROR)
    assert likeness.right_twin(turned(likeness.truths, 4.9)) is True
    assert likeness.right_twin(turned(likeness.twins, 4.9)) is False
    assert likeness.right_twin(turned(likeness.truths, 30.0)) is None
    assert likeness_of(HALF_TURN).right_twin(likeness.truths) is None


def test_the_margin_is_to_the_best_basin_that_is_not_the_truths():
    values, errors = np.array([12.0, 11.0, 7.0]), np.array([40.0, 1.0, 90.0])
    assert margin(10.0, values, errors) == pytest.approx(-1.0)  # 11 counts for the truth
    assert margin(14.5, values, errors) == pytest.approx(2.5)
    assert margin(10.0, values[1:2], errors[1:2]) is None


def test_a_twin_that_climbs_to_the_truth_is_no_twin():
    assert twin_margin(10.0, np.array([9.0, 30.0]), np.array([60.0, 0.1])) == pytest.approx(1.0)
    assert twin_margin(10.0, np.array([30.0]), np.array([0.1])) is None


def test_the_deviation_is_measured_along_the_bodys_axes(truth, likeness_of):
    refined = likeness_of().truths
    covariance = np.diag([1.0, np.deg2rad(2.0) ** 2, 1.0, 5.0, 5.0, 5.0])
    assert squared_deviation(refined, covariance, turned(refined, 3.0)) == pytest.approx(1.5**2)


def test_the_regions_hold_half_and_nine_tenths():
    drawn = np.sum(draw(np.random.default_rng(0), np.eye(3), POSE_DEGREES_OF_FREEDOM, 200_000) ** 2, axis=1)
    assert np.mean(drawn < REGION_50) == pytest.approx(0.5, abs=0.005)
    assert np.mean(drawn < REGION_90) == pytest.approx(0.9, abs=0.005)

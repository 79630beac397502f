"""Equation 5: the expected pose, averaged on the spaces that its coordinates live in; and the spread about it."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.spatial.transform import Rotation

from service.inference.estimate import mean_pose, mean_rotation, spread
from service.inference.pose import angle_between, exp_so3, local, log_so3, multiply, retract
from service.inference.state import Poses

NO_JOINTS = np.zeros(0, bool)


def turns(axis, degrees) -> np.ndarray:
    return exp_so3(np.deg2rad(np.asarray(degrees, dtype=float))[:, None] * np.asarray(axis, dtype=float))


def poses_of(quaternion, position=None, scale_px=None, joints=None) -> Poses:
    n = len(quaternion)
    return Poses(
        np.asarray(quaternion, dtype=float),
        np.zeros((n, 2)) if position is None else np.array(position, dtype=float),
        np.zeros(n) if scale_px is None else np.log(scale_px),
        np.zeros((n, 0)) if joints is None else np.array(joints, dtype=float),
    )


def test_equation_5_by_hand():
    """Weights 1/2, 1/4, 1/4: x = (4 + 10 + 6) / ... and so on; scale is averaged, not its logarithm."""
    poses = poses_of(turns((0, 0, 1), [10, 30, 50]), [[4, 0], [10, 8], [6, 4]], [2.0, 4.0, 8.0], [[1.0], [-1.0], [3.0]])
    mean = mean_pose(poses, np.array([0.5, 0.25, 0.25]), np.array([False]))
    np.testing.assert_allclose(mean.position, [[6, 3]])
    np.testing.assert_allclose(np.exp(mean.log_scale), [4])
    np.testing.assert_allclose(mean.joints, [[1]])
    np.testing.assert_allclose(np.rad2deg(log_so3(mean.quaternion)), [[0, 0, 25]], atol=1e-9)


@pytest.mark.parametrize("axis", [(1, 0, 0), (0, 1, 0), (0, 0, 1), (0.6, 0, 0.8)])
def test_rotations_are_averaged_across_the_wrap(axis):
    """170 and -170 degrees about an axis are 20 degrees apart: their mean is 180, not 0."""
    mean = mean_rotation(turns(axis, [170, -170]), np.array([0.5, 0.5]))
    assert np.rad2deg(angle_between(mean, turns(axis, [180])[0])) == pytest.approx(0, abs=1e-6)
    mean = mean_rotation(turns(axis, [170, -170]), np.array([0.75, 0.25]))
    assert np.rad2deg(angle_between(mean, turns(axis, [175])[0])) == pytest.approx(0, abs=1e-6)


def test_the_sign_of_a_quaternion_does_not_matter():
    q = turns((0, 1, 0), [10, 20, 30, 60])
    weights = np.array([0.1, 0.2, 0.3, 0.4])
    flipped = q * np.array([1, -1, -1, 1])[:, None]
    np.testing.assert_allclose(mean_rotation(flipped, weights), mean_rotation(q, weights), atol=1e-12)
    assert mean_rotation(-q, weights)[0] > 0


@settings(max_examples=40)
@given(arrays(np.float64, (5, 3), elements=st.floats(-0.4, 0.4)), st.integers(0, 1000))
def test_the_mean_leaves_no_first_moment_and_turns_with_the_body(vectors, seed):
    """Weighted rotation vectors about the mean cancel (the definition), from whatever side one looks."""
    rng = np.random.default_rng(seed)
    weights = rng.dirichlet(np.ones(5))
    base = rng.standard_normal(4)
    base /= np.linalg.norm(base)
    q = multiply(base, exp_so3(vectors))
    mean = mean_rotation(q, weights)
    centre = poses_of(mean[None])
    first = weights @ local(centre, poses_of(q))[:, :3]
    np.testing.assert_allclose(first, 0, atol=1e-8)
    turned = mean_rotation(multiply(base, q), weights)
    assert float(angle_between(turned, multiply(base, mean))) < 1e-8


def test_the_mean_minimises_the_squared_angles():
    rng = np.random.default_rng(2)
    q, weights = exp_so3(0.8 * rng.standard_normal((30, 3))), rng.dirichlet(np.ones(30))
    mean = mean_rotation(q, weights)
    least = weights @ angle_between(mean, q) ** 2
    for step in 1e-3 * np.vstack([np.eye(3), -np.eye(3)]):
        assert weights @ angle_between(multiply(mean, exp_so3(step)), q) ** 2 > least


def test_the_mean_agrees_with_scipy_for_close_rotations():
    rng = np.random.default_rng(3)
    q, weights = exp_so3(0.02 * rng.standard_normal((50, 3))), rng.dirichlet(np.ones(50))
    expected = Rotation.from_quat(q, scalar_first=True).mean(weights).as_quat(scalar_first=True)
    assert float(angle_between(mean_rotation(q, weights), expected)) < 1e-5


def test_one_particle_is_its_own_mean():
    q = turns((0.6, 0, -0.8), [123.0])
    poses = poses_of(q, [[1, 2]], [3.0], [[4.0]])
    mean = mean_pose(poses, np.ones(1), np.array([False]))
    np.testing.assert_allclose(local(mean, poses), 0, atol=1e-12)
    found = spread(poses, np.ones(1), mean, np.array([False]))
    assert (found.orientation_deg, found.x_px, found.scale_px) == pytest.approx((0, 0, 0), abs=1e-9)


def test_full_turn_joints_are_averaged_on_their_circle():
    """350 and 20 degrees are 30 apart: the mean is 5. A joint between stops has no such way round."""
    poses = poses_of(turns((0, 0, 1), [0, 0]), joints=[[350.0, 350.0], [20.0, 20.0]])
    mean = mean_pose(poses, np.array([0.5, 0.5]), np.array([True, False]))
    assert np.mod(mean.joints[0, 0], 360) == pytest.approx(5)
    assert mean.joints[0, 1] == pytest.approx(185)
    found = spread(poses, np.array([0.5, 0.5]), mean, np.array([True, False]))
    np.testing.assert_allclose(found.joints, [15, 165])


def test_spread_by_hand():
    """Two equal particles 8 degrees apart about z, 6 px apart in x, scales 9 and 11, joints 2 apart."""
    poses = poses_of(turns((0, 0, 1), [-4, 4]), [[-3, 1], [3, 1]], [9.0, 11.0], [[1.0], [3.0]])
    weights = np.array([0.5, 0.5])
    found = spread(poses, weights, mean_pose(poses, weights, np.array([False])), np.array([False]))
    assert found.orientation_deg == pytest.approx(4)
    assert (found.yaw_deg, found.pitch_deg, found.roll_deg) == pytest.approx((4, 0, 0), abs=1e-6)
    assert (found.x_px, found.y_px, found.scale_px) == pytest.approx((3, 0, 1))
    np.testing.assert_allclose(found.joints, [1])
    assert found.covariance.shape == (7, 7)
    assert found.covariance[2, 2] == pytest.approx(16)
    assert found.covariance[2, 3] == pytest.approx(12)  # rz and x move together: 4 degrees with 3 px
    np.testing.assert_allclose(found.covariance, found.covariance.T)


def test_covariance_is_that_of_the_tangent_steps():
    rng = np.random.default_rng(4)
    centre = poses_of(np.tile(turns((0.6, 0, 0.8), [100.0]), (20_000, 1)), np.zeros((20_000, 2)))
    deviation = np.array([0.01, 0.02, 0.03, 1.0, 2.0, 0.01])
    poses = retract(centre, rng.standard_normal((20_000, 6)) * deviation)
    weights = np.full(20_000, 1 / 20_000)
    found = spread(poses, weights, mean_pose(poses, weights, NO_JOINTS), NO_JOINTS)
    expected = np.array([*np.rad2deg(deviation[:3]), *deviation[3:]])
    np.testing.assert_allclose(np.sqrt(np.diag(found.covariance)), expected, rtol=0.03)
    assert found.orientation_deg == pytest.approx(np.rad2deg(np.sqrt(14) / 100), rel=0.03)

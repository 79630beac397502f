"""Geometry of poses: conventions of the contract against SciPy and numbers worked out by hand."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.spatial.transform import Rotation

from service.inference.pose import (
    angle_between,
    concatenate,
    conjugate,
    exp_so3,
    from_matrices,
    local,
    log_so3,
    multiply,
    retract,
    rotation_matrices,
    yaw_pitch_roll_deg,
)
from service.inference.state import Poses

examples = settings(max_examples=60)
vectors = arrays(np.float64, (4, 3), elements=st.floats(-1.8, 1.8))  # shorter than pi


def rotations(count: int, seed: int = 1) -> np.ndarray:
    q = np.random.default_rng(seed).standard_normal((count, 4))
    return q / np.linalg.norm(q, axis=1, keepdims=True)


def scipy(q: np.ndarray) -> Rotation:
    return Rotation.from_quat(q, scalar_first=True)


def some_poses(count: int, n_joints: int, seed: int = 2) -> Poses:
    rng = np.random.default_rng(seed)
    return Poses(
        rotations(count, seed),
        rng.uniform(0, 256, (count, 2)),
        rng.uniform(-2, 3, count),
        rng.uniform(-90, 90, (count, n_joints)),
    )


def same_rotation(a: np.ndarray, b: np.ndarray, tolerance: float = 1e-12) -> None:
    np.testing.assert_allclose(rotation_matrices(a), rotation_matrices(b), atol=tolerance)


def test_matrix_of_a_quarter_turn_about_z_takes_x_to_y():
    half = np.sqrt(0.5)
    np.testing.assert_allclose(
        rotation_matrices(np.array([half, 0, 0, half])), [[0, -1, 0], [1, 0, 0], [0, 0, 1]], atol=1e-15
    )


def test_matrices_and_products_agree_with_scipy():
    a, b = rotations(200, 3), rotations(200, 4)
    np.testing.assert_allclose(rotation_matrices(a), scipy(a).as_matrix(), atol=1e-14)
    same_rotation(multiply(a, b), (scipy(a) * scipy(b)).as_quat(scalar_first=True))
    same_rotation(conjugate(a), scipy(a).inv().as_quat(scalar_first=True))
    np.testing.assert_allclose(
        rotation_matrices(multiply(a, b)), rotation_matrices(a) @ rotation_matrices(b), atol=1e-14
    )


def test_product_by_hand():
    i, j, k = np.eye(4)[1:]
    np.testing.assert_array_equal(multiply(i, j), k)
    np.testing.assert_array_equal(multiply(j, i), -k)
    np.testing.assert_array_equal(multiply(i, i), [-1, 0, 0, 0])


def test_one_rotation_multiplies_a_batch():
    q = rotations(5)
    np.testing.assert_array_equal(multiply(q[0], q)[3], multiply(q[0], q[3]))


def test_from_matrices_keeps_leading_axes_and_w_positive():
    q = rotations(12).reshape(3, 4, 4)
    back = from_matrices(rotation_matrices(q))
    assert back.shape == (3, 4, 4)
    assert np.all(back[..., 0] >= 0)
    same_rotation(back, q)


@examples
@given(vectors)
def test_exp_and_log_are_inverse_and_agree_with_scipy(vector):
    q = exp_so3(vector)
    np.testing.assert_allclose(np.linalg.norm(q, axis=1), 1, atol=1e-14)
    same_rotation(q, Rotation.from_rotvec(vector).as_quat(scalar_first=True))
    np.testing.assert_allclose(log_so3(q), vector, atol=1e-9)
    np.testing.assert_allclose(log_so3(-q), vector, atol=1e-9)


@pytest.mark.parametrize("angle", [0.0, 1e-300, 1e-160, 1e-12, 1e-7, 1.0, np.pi - 1e-7, np.pi])
def test_exp_and_log_near_nothing_and_near_half_a_turn(angle):
    vector = angle * np.array([2.0, -1.0, 2.0]) / 3
    np.testing.assert_allclose(log_so3(exp_so3(vector)), vector, rtol=1e-8, atol=0)


def test_log_is_never_longer_than_half_a_turn():
    vector = np.array([0.0, 0.0, np.pi + 0.25])  # the same as pi - 0.25 the other way
    np.testing.assert_allclose(log_so3(exp_so3(vector)), [0, 0, -(np.pi - 0.25)], atol=1e-14)


@pytest.mark.parametrize("angle", [0.0, 1e-15, 1e-10, 1e-5, 0.9, 0.902, 0.91, 2.0, np.pi - 1e-6, np.pi])
def test_angle_between_is_accurate_from_nothing_to_half_a_turn(angle):
    a = rotations(20)
    axis = np.array([0.6, 0.0, -0.8])
    b = multiply(a, exp_so3(angle * axis))
    for other in (b, -b):  # q and -q are one rotation
        np.testing.assert_allclose(angle_between(a, other), angle, rtol=1e-8, atol=1e-15)


def test_angle_between_agrees_with_scipy():
    a, b = rotations(500, 5), rotations(500, 6)
    np.testing.assert_allclose(angle_between(a, b), (scipy(a).inv() * scipy(b)).magnitude(), atol=1e-10)


@examples
@given(arrays(np.float64, (3, 8), elements=st.floats(-1.5, 1.5)))
def test_local_undoes_retract(delta):
    poses = some_poses(3, 2)
    np.testing.assert_allclose(local(poses, retract(poses, delta)), delta, atol=1e-9)


def test_retract_undoes_local():
    a, b = some_poses(50, 1, 7), some_poses(50, 1, 8)
    moved = retract(a, local(a, b))
    same_rotation(moved.quaternion, b.quaternion)
    np.testing.assert_allclose(moved.position, b.position)
    np.testing.assert_allclose(moved.log_scale, b.log_scale)
    np.testing.assert_allclose(moved.joints, b.joints)


def test_local_of_one_origin_is_that_of_each():
    poses = some_poses(6, 2)
    np.testing.assert_array_equal(local(poses[:1], poses)[4], local(poses[:1], poses[4:5])[0])


def test_a_tangent_rotation_is_on_the_body_side():
    """R exp([v]x): the step turns the body about its own axes before the old orientation is applied."""
    half = np.sqrt(0.5)
    start = Poses(np.array([[half, 0, 0, half]]), np.zeros((1, 2)), np.zeros(1), np.zeros((1, 0)))
    moved = retract(start, np.array([[np.pi / 2, 0, 0, 3.0, -4.0, 0.5]]))
    # Body y -> (about body x) body z -> (about z) z.
    np.testing.assert_allclose(rotation_matrices(moved.quaternion)[0] @ [0, 1, 0], [0, 0, 1], atol=1e-15)
    # Body x is the axis of the step: only the old orientation moves it, to y.
    np.testing.assert_allclose(rotation_matrices(moved.quaternion)[0] @ [1, 0, 0], [0, 1, 0], atol=1e-15)
    np.testing.assert_array_equal(moved.position, [[3, -4]])
    np.testing.assert_array_equal(moved.log_scale, [0.5])


def test_yaw_pitch_roll_are_those_of_the_contract():
    q = rotations(300, 9)
    np.testing.assert_allclose(yaw_pitch_roll_deg(q), scipy(q).as_euler("ZYX", degrees=True), atol=1e-9)


def test_yaw_pitch_roll_by_hand():
    """R = Rz(90) Ry(30) Rx(0): body x -> (cos 30, 0, -sin 30) -> (0, cos 30, -sin 30)."""
    matrix = np.array([[0, -1, 0], [np.sqrt(0.75), 0, 0.5], [-0.5, 0, np.sqrt(0.75)]])
    np.testing.assert_allclose(yaw_pitch_roll_deg(from_matrices(matrix)), [90, 30, 0], atol=1e-12)


@pytest.mark.parametrize("pitch", [90.0, -90.0, 90 - 1e-5, -90 + 1e-5])
@pytest.mark.parametrize(("yaw", "roll"), [(0, 0), (40, 0), (0, 40), (25, 110), (-170, 60)])
def test_yaw_pitch_roll_give_the_rotation_back_even_where_they_are_not_unique(yaw, pitch, roll):
    q = Rotation.from_euler("ZYX", [yaw, pitch, roll], degrees=True).as_quat(scalar_first=True)
    back = Rotation.from_euler("ZYX", yaw_pitch_roll_deg(q), degrees=True)
    assert np.rad2deg((back.inv() * scipy(q)).magnitude()) < 1e-4


def test_indexing_and_concatenation_keep_particles_together():
    poses = some_poses(5, 2)
    assert len(poses) == 5
    both = concatenate(poses[3:], poses[np.array([True, False, False, True, False])])
    for name in ("quaternion", "position", "log_scale", "joints"):
        np.testing.assert_array_equal(getattr(both, name), getattr(poses, name)[[3, 4, 0, 3]])

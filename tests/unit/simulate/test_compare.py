"""Errors of a pose: known angles, twins, circles of joints, overlap."""

import numpy as np
import pytest

from gpu.reference import silhouette_mask
from service.inference.articulation import part_transforms
from service.inference.pose import exp_so3, from_matrices, multiply, rotation_matrices
from service.inference.state import Poses
from service.simulate.compare import compare, joint_error, orientation_error_deg, silhouette


def pose(quaternion, x=64.0, y=60.0, scale=9.0, wing=20.0) -> Poses:
    return Poses(np.array([quaternion]), np.array([[x, y]]), np.log([scale]), np.array([[wing]]))


START = np.array([0.5, 0.1, -0.7, 0.5])  # of length 1 and nothing special


def test_the_truth_has_no_error(demo):
    _, mesh, articulation = demo
    errors = compare(mesh, articulation, pose(START), pose(-START), (128, 128))
    assert (errors.orientation_deg, errors.position_px, errors.scale_percent, errors.joint) == (0, 0, 0, 0)
    assert errors.iou == 1.0


def test_each_error_is_what_was_put_in(demo):
    _, mesh, articulation = demo
    turned = multiply(START, exp_so3(np.deg2rad([0.0, 3.0, 4.0])))
    errors = compare(mesh, articulation, pose(START), pose(turned, 67.0, 64.0, 9.45, -175.0 + 360), (128, 128))
    assert errors.orientation_deg == pytest.approx(5.0)
    assert errors.position_px == pytest.approx(5.0)
    assert errors.scale_percent == pytest.approx(5.0)
    assert errors.joint == pytest.approx(165.0)
    assert 0.2 < errors.iou < 0.9


@pytest.mark.parametrize("angle", [1e-6, 0.01, 90.0, 179.9999])
def test_angles_are_exact_from_tiny_to_half_a_turn(angle):
    turned = multiply(START, exp_so3(np.deg2rad([angle, 0.0, 0.0])))
    assert orientation_error_deg(START, turned) == pytest.approx(angle, rel=1e-6)


def test_twins_and_rotation_symmetries_count_as_right():
    mirror, turn = np.diag([1.0, -1.0, 1.0]), np.diag([-1.0, -1.0, 1.0])
    real = rotation_matrices(START)
    twin = from_matrices((np.diag([1.0, 1.0, -1.0]) @ real @ mirror)[None])[0]
    assert orientation_error_deg(START, twin) > 10
    assert orientation_error_deg(START, twin, [mirror]) == pytest.approx(0, abs=1e-6)
    half = from_matrices((real @ turn)[None])[0]
    assert orientation_error_deg(START, half, [mirror]) > 10
    assert orientation_error_deg(START, half, [mirror, turn]) == pytest.approx(0, abs=1e-6)


def test_joints_are_compared_on_their_circle(demo):
    (joint,) = demo[2].joints
    assert joint_error(joint, -179.0, 178.0) == pytest.approx(3.0)
    assert joint_error(joint, 10.0, 20.0) == pytest.approx(10.0)


def test_the_silhouette_is_the_scorers(demo):
    _, mesh, articulation = demo
    one = pose(START)
    expected = silhouette_mask(mesh, part_transforms(articulation, one)[0], (128, 128))
    assert (silhouette(mesh, articulation, one, (128, 128)) != expected).sum() <= 2

"""Twins of poses: the silhouette stays, the rates turn with the pose, an involution undoes itself."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from gpu.mesh import assemble
from gpu.raw_part import RawPart
from gpu.reference import silhouette_mask
from service.inference.articulation import Articulation, Joint, Stage, part_transforms
from service.inference.pose import angle_between, retract
from service.inference.state import Poses
from service.inference.symmetry import Symmetry, twin, twin_rates
from service.simulate.primitives import box, merged

IDENTITY = ((1.0, 0, 0), (0, 1.0, 0), (0, 0, 1.0))
MIRROR_Y = ((1.0, 0, 0), (0, -1.0, 0), (0, 0, 1.0))
HALF_TURN_X = ((1.0, 0, 0), (0, -1.0, 0), (0, 0, -1.0))
QUARTER_TURN_Z = ((0, -1.0, 0), (1.0, 0, 0), (0, 0, 1.0))


def random_poses(count=6, joints=0, seed=5) -> Poses:
    rng = np.random.default_rng(seed)
    return Poses(
        Rotation.random(count, rng).as_quat(scalar_first=True),
        np.array([60.0, 60.0]) + rng.normal(0, 3, (count, 2)),
        np.log(rng.uniform(9, 12, count)),
        rng.uniform(-170, 170, (count, joints)),
    )


def least_overlap(mesh, articulation, poses, others) -> float:
    shares = []
    for a, b in zip(part_transforms(articulation, poses), part_transforms(articulation, others), strict=True):
        first, second = (silhouette_mask(mesh, transforms, (120, 120)) for transforms in (a, b))
        shares.append(np.sum(first & second) / np.sum(first | second))
    return float(min(shares))


def mesh_of(**solids):
    return assemble([RawPart(name, np.asarray(s.vertices, float), np.asarray(s.faces)) for name, s in solids.items()])


def satellite():
    """Mirrored across the plane y = 0.6 of the file, with a flat panel hinged along x in that plane."""
    bus = merged([box((1.2, 2, 1.4)), box((0.5, 1.0, 0.6)).moved((0.5, 0, 0.9))]).moved((0, 0.6, 0))
    marker = box((0.2, 0.2, 0.2)).moved((0, 3.0, 0))  # moves the bounding box, and is left out of the parts below
    whole = mesh_of(bus=bus, panel=box((2.4, 1.2, 0.04)).moved((2, 0.6, 0)), marker=marker)
    shown = type(whole)(whole.parts[:2], whole.centre, whole.size, whole.radius, whole.watertight)
    hinge = Stage("revolute", ("panel",), (1.0, 0, 0), tuple(np.array([0, 0.6, 0]) - whole.centre))
    offset = 2 * (0.6 - whole.centre[1])
    articulation = Articulation(("bus", "panel"), (Joint("wing", "revolute", -180, 180, 0, (hinge,)),))
    return shown, articulation, (0.0, offset, 0.0)


@pytest.mark.parametrize(
    ("matrix", "size"), [(MIRROR_Y, (2, 3, 4)), (HALF_TURN_X, (2, 3, 4)), (QUARTER_TURN_Z, (3, 3, 2))]
)
def test_a_twin_of_a_rigid_body_has_the_same_silhouette(matrix, size):
    mesh = mesh_of(brick=box(size))
    poses = random_poses()
    others = twin(poses, Symmetry(matrix))
    assert least_overlap(mesh, Articulation(("brick",)), poses, others) > 0.98
    assert np.all(angle_between(poses.quaternion, others.quaternion) > 0.05)


@pytest.mark.parametrize(("matrix", "sign"), [(MIRROR_Y, -1.0), (IDENTITY, 1.0)])
@pytest.mark.parametrize("shift", [0.0, 180.0])
def test_a_mirror_plane_away_from_the_origin_and_a_flat_panel(matrix, sign, shift):
    """S Rot(a, v) S^-1 = Rot(det(S) S a, v): for a mirror across y and an axis x the panel turns the other way."""
    mesh, articulation, offset = satellite()
    poses = random_poses(joints=1)
    symmetry = Symmetry(matrix, offset if matrix is MIRROR_Y else (0.0, 0.0, 0.0), (sign,), (shift,))
    assert least_overlap(mesh, articulation, poses, twin(poses, symmetry)) > 0.98


def test_the_wrong_sign_is_no_twin():
    mesh, articulation, offset = satellite()
    poses = random_poses(joints=1)
    assert least_overlap(mesh, articulation, poses, twin(poses, Symmetry(MIRROR_Y, offset, (1.0,), (0.0,)))) < 0.95


def test_a_mirror_twice_is_the_pose_itself():
    poses = random_poses(joints=1)
    symmetry = Symmetry(MIRROR_Y, (0.0, 0.7, 0.0), (-1.0,), (20.0,))
    again = twin(twin(poses, symmetry), symmetry)
    assert angle_between(again.quaternion, poses.quaternion).max() < 1e-7
    np.testing.assert_allclose(again.position, poses.position, atol=1e-9)
    np.testing.assert_allclose(again.joints, poses.joints, atol=1e-9)


@pytest.mark.parametrize("matrix", [MIRROR_Y, HALF_TURN_X, QUARTER_TURN_Z])
def test_rates_turn_with_the_pose(matrix):
    """The twin of a moved pose is the twin, moved by the twin's rates (offset at the origin)."""
    poses, symmetry = random_poses(joints=1), Symmetry(matrix, joint_sign=(-1.0,), joint_shift=(0.0,))
    rates = np.random.default_rng(1).normal(0, 0.2, (len(poses), 7))
    one_way = twin(retract(poses, rates), symmetry)
    other = retract(twin(poses, symmetry), twin_rates(rates, symmetry))
    assert angle_between(one_way.quaternion, other.quaternion).max() < 1e-7
    np.testing.assert_allclose(one_way.joints, other.joints, atol=1e-9)


def test_kinds():
    kinds = [Symmetry(matrix).kind for matrix in (IDENTITY, MIRROR_Y, HALF_TURN_X)]
    assert kinds == ["joint", "mirror", "rotation"]

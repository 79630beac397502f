"""Symmetries that the silhouette keeps: solids whose group is known, spacecraft that somebody has listed, joints."""

import json

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from gpu.mesh import assemble, load_mesh
from gpu.raw_part import RawPart
from service.inference.articulation import Articulation, Joint, Stage, hold, part_transforms
from service.inference.state import Poses
from service.inference.symmetry import twin
from service.models.articulations import read_joints
from service.models.silhouettes import Silhouettes, Target, overlap
from service.models.symmetry import (
    describe_symmetries,
    find_joint_periods,
    find_symmetries,
    model_symmetries,
    with_periods,
)
from service.models.symmetry_group import held_symmetries
from service.simulate.primitives import Solid, box, cone, merged

MESHES = (
    *("grace_fo", "hubble", "iss", "mdlsat", "shuttle_orbiter"),
    *("shuttle_orbiter_lod", "suomi_npp", "tdrs", "topex_poseidon"),
)
TILT = Rotation.from_rotvec([0.5, 0.9, -0.4]).as_matrix()


def mesh_of(**solids: Solid):
    return assemble([RawPart(name, np.asarray(s.vertices, float), np.asarray(s.faces)) for name, s in solids.items()])


def rigid(mesh) -> Articulation:
    return Articulation(tuple(part.name for part in mesh.parts))


def hinge(name="panel", axis=(1.0, 0, 0), origin=(0.0, 0, 0), low=-180.0, high=180.0, initial=0.0, part=None):
    return Joint(name, "revolute", low, high, initial, (Stage("revolute", (part or name,), axis, origin),))


def signs(symmetries) -> set[tuple[float, ...]]:
    """Diagonals of the matrices; a matrix that is not diagonal gives NaN."""
    return {
        tuple(np.diag(np.round(s.matrix, 6))) if np.allclose(s.matrix, np.diag(np.diag(s.matrix))) else (np.nan,)
        for s in symmetries
    }


def pyramid(angle_deg: float) -> Solid:
    """A square pyramid, turned about its axis z."""
    angle = np.deg2rad(angle_deg) + np.pi / 2 * np.arange(4)
    base = np.column_stack([np.cos(angle), np.sin(angle), np.zeros(4)])
    faces = [[0, 1, 4], [1, 2, 4], [2, 3, 4], [3, 0, 4], [0, 2, 1], [0, 3, 2]]
    return Solid(np.vstack([base, [[0, 0, 1.7]]]), np.array(faces))


def looks_alike(mesh, articulation, symmetries, seed=3, count=8) -> float:
    """Least overlap of random poses with their twins, joints anywhere in their ranges."""
    rng = np.random.default_rng(seed)
    views = Silhouettes(mesh, articulation, count)
    low, high = (np.array([getattr(j, e) for j in articulation.joints]) for e in ("minimum", "maximum"))
    joints = low + rng.random((count, len(low))) * (high - low)
    poses = views.poses(joints, Target(np.zeros(3), 1.1 * mesh.radius))
    turned = Poses(Rotation.random(count, rng).as_quat(scalar_first=True), *(poses.position, poses.log_scale, joints))
    seen = views.draw(turned)
    return min(float(overlap(seen, views.draw(twin(turned, s))).min()) for s in symmetries)


@pytest.mark.parametrize("name", MESHES)
def test_spacecraft_have_the_symmetries_that_are_listed_for_them(shared, name):
    """The list is of sign matrices, for the body as it is in the file."""
    file = shared / "data" / "meshes" / f"{name}.glb"
    data = file.read_bytes()
    mesh = load_mesh(data, "glb")
    articulation = read_joints(data, "glb", mesh).articulation
    listed = json.loads((file.parent / "symmetry.json").read_text())[file.name]
    at_rest = held_symmetries(find_symmetries(mesh, articulation), articulation, hold(articulation, (), {}))
    assert signs(at_rest) == {tuple(np.diag(matrix)) for matrix in listed}
    assert len(at_rest) == len(listed)


@pytest.mark.parametrize(("name", "joint"), [("hubble", "Arrays"), ("mdlsat", "SolarArray")])
def test_arrays_of_spacecraft_turn_the_other_way_in_the_mirror(shared, name, joint):
    data = (shared / "data" / "meshes" / f"{name}.glb").read_bytes()
    mesh = load_mesh(data, "glb")
    articulation = read_joints(data, "glb", mesh).articulation
    found = model_symmetries(mesh, articulation)
    assert found.joint_periods == (180.0,)
    for symmetry in found.symmetries:
        axis = np.asarray(articulation.joints[0].stages[0].axis)
        matrix = np.asarray(symmetry.matrix)
        assert symmetry.joint_sign == (round(float(np.linalg.det(matrix) * axis @ matrix @ axis)),)
    assert looks_alike(mesh, articulation, found.symmetries) > 0.93
    assert describe_symmetries(found.symmetries, articulation)[0]["joints"].keys() == {joint}


def test_a_brick_has_three_mirror_planes_three_half_turns_and_the_inversion():
    mesh = mesh_of(brick=box((2, 3, 4.5)))
    found = find_symmetries(mesh, rigid(mesh))
    expected = {(x, y, z) for x in (-1.0, 1.0) for y in (-1.0, 1.0) for z in (-1.0, 1.0)} - {(1.0, 1.0, 1.0)}
    assert len(found) == 7
    assert signs(found) == expected
    assert sorted(s.kind for s in found) == ["mirror"] * 4 + ["rotation"] * 3
    assert looks_alike(mesh, rigid(mesh), found) > 0.98


def test_a_tilted_brick_is_found_by_its_principal_axes():
    mesh = mesh_of(brick=box((2, 3, 4.5)).moved(rotation=TILT))
    found = find_symmetries(mesh, rigid(mesh))
    assert len(found) == 7
    mirrors = [TILT @ (np.eye(3) - 2 * np.outer(e, e)) @ TILT.T for e in np.eye(3)]
    for mirror in mirrors:
        assert min(np.abs(np.asarray(s.matrix) - mirror).max() for s in found) < 1e-6
    assert looks_alike(mesh, rigid(mesh), found) > 0.98


@pytest.mark.parametrize("angle_deg", [0, 45, 17])
def test_a_square_pyramid_has_four_mirror_planes_however_it_is_turned_about_its_axis(angle_deg):
    mesh = mesh_of(pyramid=pyramid(angle_deg))
    found = find_symmetries(mesh, rigid(mesh))
    assert sorted(s.kind for s in found) == ["mirror"] * 4 + ["rotation"] * 3
    assert all(np.allclose(np.asarray(s.matrix)[2], [0, 0, 1], atol=1e-3) for s in found)
    assert looks_alike(mesh, rigid(mesh), found) > 0.97


def test_an_irregular_tetrahedron_has_none():
    corners = np.array([[0, 0, 0], [3, 0, 0], [0.7, 2, 0], [0.4, 0.3, 1.3]])
    faces = np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]])
    mesh = mesh_of(body=Solid(corners, faces))
    assert find_symmetries(mesh, rigid(mesh)) == ()


def test_a_mirror_plane_need_not_go_through_the_middle_of_the_bounding_box():
    corners = np.array([[0, -2, 0], [0, 2, 0], [4, -2, 0], [4, 2, 0], [0, -2, 3], [0, 2, 3]])
    faces = np.array([[0, 1, 3], [0, 3, 2], [0, 4, 5], [0, 5, 1], [2, 3, 5], [2, 5, 4], [0, 2, 4], [1, 5, 3]])
    wedge = Solid(corners.astype(float), faces)
    aerial = box((0.04, 1.0, 0.04)).moved((1.0, 2.5, 0.5))
    mesh = mesh_of(body=merged([wedge, aerial]))
    (found,) = find_symmetries(mesh, rigid(mesh))
    np.testing.assert_allclose(found.matrix, np.diag([1, -1, 1]))
    plane = 0.5 * found.offset[1] + mesh.centre[1]  # the fixed point of y -> -y + offset, in file coordinates
    assert mesh.centre[1] == pytest.approx(0.5)
    assert plane == pytest.approx(0.0, abs=0.02)
    assert looks_alike(mesh, rigid(mesh), [found]) > 0.95


def test_a_body_of_revolution_is_warned_of():
    mesh = mesh_of(body=cone(1.0, 0.4, 2.0, 48))
    found = model_symmetries(mesh, rigid(mesh))
    assert any("every turn about the axis (0, 0, 1)" in warning for warning in found.warnings)
    assert found.round_axes == ((0.0, 0.0, 1.0),)
    assert len(found.symmetries) == 7
    assert looks_alike(mesh, rigid(mesh), found.symmetries) > 0.97


def test_of_a_prism_of_few_sides_light_tells_the_turn_that_its_outline_does_not():
    mesh = mesh_of(body=cone(1.0, 1.0, 2.0, 12))
    found = model_symmetries(mesh, rigid(mesh))
    assert any("light alone tells it" in warning for warning in found.warnings)
    assert found.round_axes == ()


def flat_panel(initial=0.0, low=-180.0, high=180.0, tilt_deg=0.0):
    """A body without symmetry and a flat panel on an axis through its middle, canted by ``tilt_deg`` in the file."""
    body = merged([box((1, 1.4, 2)), box((0.5, 0.4, 0.5)).moved((-0.6, 0.7, 0.9))])
    panel = box((3, 1.2, 0.05)).moved(rotation=Rotation.from_euler("x", tilt_deg, degrees=True).as_matrix())
    mesh = mesh_of(body=body, panel=panel.moved((2.2, 0.1, 0.2)))
    origin = np.array([0, 0.1, 0.2]) - mesh.centre
    joint = hinge(origin=tuple(origin), low=low, high=high, initial=initial)
    return mesh, Articulation(("body", "panel"), (joint,))


def test_a_flat_panel_looks_the_same_after_half_a_turn():
    mesh, articulation = flat_panel()
    (found,) = find_symmetries(mesh, articulation)
    assert (found.kind, found.joint_sign, found.joint_shift) == ("joint", (1.0,), (180.0,))
    np.testing.assert_allclose(found.matrix, np.eye(3))
    assert looks_alike(mesh, articulation, [found]) > 0.98
    periods = find_joint_periods(mesh, articulation)
    assert periods == (180.0,)
    assert with_periods(articulation, periods).joints[0].period == 180.0


def test_half_a_turn_out_of_a_joints_range_is_no_twin_of_any_pose():
    mesh, articulation = flat_panel(low=-60, high=60)
    assert find_symmetries(mesh, articulation) == ()
    assert find_joint_periods(mesh, articulation) == (None,)


def test_a_mirror_holds_only_at_rest_where_the_mirrored_joint_would_leave_its_range():
    body = merged([box((1, 1.4, 2)), box((0.5, 1.0, 0.5)).moved((-0.6, 0, 0.9))])
    mesh = mesh_of(body=body, panel=box((3, 1.2, 0.05)).moved((2.2, 0, 0.2)))
    joint = hinge(origin=tuple(np.array([0, 0, 0.2]) - mesh.centre), low=0, high=60)
    (found,) = find_symmetries(mesh, Articulation(("body", "panel"), (joint,)))
    assert (found.kind, found.joint_sign, found.joint_shift) == ("mirror", (0.0,), (0.0,))


def test_a_square_rod_repeats_every_quarter_turn_and_a_round_one_hides_its_joint():
    body = merged([box((1, 1.4, 2)), box((0.5, 0.4, 0.5)).moved((-0.6, 0.7, 0.9))])
    quarter = Rotation.from_euler("y", 90, degrees=True).as_matrix()
    for rod, hidden in ((box((0.8, 0.8, 3)), False), (cone(0.5, 0.5, 3, 64), True)):
        mesh = mesh_of(body=body, panel=rod.moved((2, 0, 0), quarter))
        articulation = Articulation(("body", "panel"), (hinge(origin=tuple(-np.array(mesh.centre))),))
        found = model_symmetries(mesh, articulation)
        assert found.joint_periods == ((45.0,) if hidden else (90.0,))
        assert any("'panel' moves nothing" in w for w in found.warnings) == hidden


@pytest.mark.parametrize("tilt_deg", [0, 25])
def test_a_mirrored_body_brings_its_canted_panel_to_the_mirrored_angle(tilt_deg):
    """Mirrored across y, a panel that the file shows at 25 degrees stands at -25: its value goes to -v - 50."""
    body = merged([box((1, 1.4, 2)), box((0.5, 1.0, 0.5)).moved((-0.6, 0, 0.9))])
    panel = box((3, 1.2, 0.05)).moved(rotation=Rotation.from_euler("x", tilt_deg, degrees=True).as_matrix())
    mesh = mesh_of(body=body, panel=panel.moved((2.2, 0, 0.2)))
    joint = hinge(origin=tuple(np.array([0, 0, 0.2]) - mesh.centre))
    articulation = Articulation(("body", "panel"), (joint,))
    found = find_symmetries(mesh, articulation)
    assert sorted(s.kind for s in found) == ["joint", "mirror", "mirror"]
    mirrors = [s for s in found if s.kind == "mirror"]
    assert {s.joint_sign for s in mirrors} == {(-1.0,)}
    shifts = sorted(s.joint_shift[0] for s in mirrors)
    np.testing.assert_allclose(shifts, sorted([-2.0 * tilt_deg, 180.0 - 2 * tilt_deg]), atol=0.6)
    assert looks_alike(mesh, articulation, found) > 0.95


def two_wings():
    body = merged([box((1, 1.4, 2)), box((0.5, 1.0, 0.5)).moved((0, 0, 1))])
    wing = box((2.4, 0.06, 1.1))
    mesh = mesh_of(body=body, left=wing.moved((-2, 0.2, 0)), right=wing.moved((2, 0.2, 0)))
    origin = tuple(np.array([0, 0.2, 0]) - mesh.centre)
    joints = tuple(hinge(name, (1.0, 0, 0), origin) for name in ("left", "right"))
    return mesh, Articulation(("body", "left", "right"), joints)


def test_a_symmetry_that_needs_a_joint_at_rest_counts_only_while_it_is_held_there():
    """Mirrored across x the wings change places: at different angles the body is not itself."""
    mesh, articulation = two_wings()
    found = find_symmetries(mesh, articulation)
    across_x = [s for s in found if np.allclose(s.matrix, np.diag([-1, 1, 1]))]
    assert [s.joint_sign for s in across_x] == [(0.0, 0.0)]

    def diagonals(free, fixed):
        held = held_symmetries(found, articulation, hold(articulation, free, fixed))
        return {d for d in signs(held) if np.linalg.det(np.diag(d)) < 0}

    assert diagonals((), {}) == {(-1, 1, 1)}
    assert diagonals("all", {}) == set()
    assert diagonals((), {"left": 30.0}) == set()
    only_left = held_symmetries(found, articulation, hold(articulation, ("left",), {}))
    assert [(s.kind, s.joint_sign, s.joint_shift) for s in only_left] == [("joint", (1.0,), (180.0,))]


def test_a_prismatic_joint_slides_the_other_way_in_the_mirror():
    body = merged([box((1, 1.4, 2)), box((0.5, 1.0, 0.5)).moved((-0.6, 0, 0.9))])
    mesh = mesh_of(body=body, slider=box((0.4, 0.5, 0.6)).moved((0.9, 0, -0.5)))
    stage = Stage("prismatic", ("slider",), (0.0, 1.0, 0.0))
    articulation = Articulation(("body", "slider"), (Joint("slide", "prismatic", -1.0, 1.0, 0.0, (stage,)),))
    (found,) = find_symmetries(mesh, articulation)
    np.testing.assert_allclose(found.matrix, np.diag([1, -1, 1]))
    assert found.joint_sign == (-1.0,)
    assert found.joint_shift == pytest.approx((0.0,), abs=0.02)


def test_finding_is_repeatable_and_documents_are_plain_json():
    mesh, articulation = two_wings()
    first, second = (model_symmetries(mesh, articulation) for _ in range(2))
    assert first == second
    documents = describe_symmetries(first.symmetries, articulation)
    assert json.loads(json.dumps(documents)) == documents
    assert all(set(d) == {"kind", "matrix", "offset", "joints"} for d in documents)


def test_quick_silhouettes_agree_with_the_reference():
    from gpu.reference import silhouette_mask

    mesh, articulation = two_wings()
    views = Silhouettes(mesh, articulation, 4)
    poses = views.poses(np.array([20.0, -70.0]), Target(np.zeros(3), mesh.radius))
    drawn = views.draw(poses)
    for mask, transforms in zip(drawn, part_transforms(articulation, poses), strict=True):
        exact = silhouette_mask(mesh, transforms, mask.shape)
        assert not np.any(exact & ~mask)  # it fills a pixel more at the edges
        assert np.sum(mask & ~exact) < 0.12 * np.sum(exact)

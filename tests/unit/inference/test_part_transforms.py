"""Joints and the projection: pixels of body points worked out by hand."""

import numpy as np
import pytest

from service.inference.articulation import Articulation, Joint, Stage, hold, part_transforms, stage_motion
from service.inference.pose import from_matrices
from service.inference.state import Poses

BUS_AND_PANEL = Articulation(
    ("bus", "panel"),
    (Joint("panel", "revolute", -180, 180, 0.0, (Stage("revolute", ("panel",), (0, 0, 1), (1, 2, 0)),)),),
)


def pose(
    matrix=((1, 0, 0), (0, 1, 0), (0, 0, 1)), position=(0.0, 0.0), scale_px=1.0, joints: tuple[float, ...] = ()
) -> Poses:
    return Poses(
        from_matrices(np.array([matrix], dtype=float)),
        np.array([position], dtype=float),
        np.log([scale_px]),
        np.array([joints], dtype=float).reshape(1, -1),
    )


def land(articulation: Articulation, poses: Poses, part: str, point, particle: int = 0) -> np.ndarray:
    transform = part_transforms(articulation, poses)[particle, articulation.parts.index(part)]
    return transform @ np.array([*point, 1.0])


def test_weak_perspective_by_hand():
    """Quarter turn about z: (1, 2, 3) -> (-2, 1, 3); times 10 px, plus (100, 50)."""
    quarter = ((0, -1, 0), (1, 0, 0), (0, 0, 1))
    found = land(Articulation(("bus",)), pose(quarter, (100, 50), 10), "bus", (1, 2, 3))
    np.testing.assert_allclose(found, [80, 60, 30], rtol=1e-6)


def test_axes_of_the_camera():
    """With no rotation a point at +x lands right, +y down (pixel rows grow downwards), z only in the depth."""
    bus = Articulation(("bus",))
    np.testing.assert_allclose(land(bus, pose(position=(5, 5)), "bus", (1, 0, 0)), [6, 5, 0], atol=1e-6)
    np.testing.assert_allclose(land(bus, pose(position=(5, 5)), "bus", (0, 1, 0)), [5, 6, 0], atol=1e-6)
    np.testing.assert_allclose(land(bus, pose(position=(5, 5)), "bus", (0, 0, 1)), [5, 5, 1], atol=1e-6)


def test_a_revolute_joint_turns_its_part_about_its_own_axis():
    """Point (3, 2, 0) is 2 right of the hinge (1, 2): after 90 degrees about z it is 2 above in y, (1, 4, 0);
    a scale of 10 and position (20, 30) put it at (30, 70)."""
    poses = pose(position=(20, 30), scale_px=10, joints=(90.0,))
    np.testing.assert_allclose(land(BUS_AND_PANEL, poses, "panel", (3, 2, 0)), [30, 70, 0], atol=1e-4)
    np.testing.assert_allclose(land(BUS_AND_PANEL, poses, "panel", (1, 2, 7)), [30, 50, 70], atol=1e-4)
    np.testing.assert_allclose(land(BUS_AND_PANEL, poses, "bus", (3, 2, 0)), [50, 50, 0], atol=1e-4)


def test_the_joint_moves_before_the_body_turns():
    """(3, 2, 0) -> joint -> (1, 4, 0) -> quarter turn about z -> (-4, 1, 0)."""
    quarter = ((0, -1, 0), (1, 0, 0), (0, 0, 1))
    np.testing.assert_allclose(
        land(BUS_AND_PANEL, pose(quarter, joints=(90.0,)), "panel", (3, 2, 0)), [-4, 1, 0], atol=1e-6
    )


def test_each_particle_has_its_own_joint():
    poses = Poses(np.tile([1.0, 0, 0, 0], (3, 1)), np.zeros((3, 2)), np.zeros(3), np.array([[0.0], [90.0], [180.0]]))
    found = [land(BUS_AND_PANEL, poses, "panel", (3, 2, 0), n)[:2] for n in range(3)]
    np.testing.assert_allclose(found, [[3, 2], [1, 4], [-1, 2]], atol=1e-6)


def test_a_prismatic_joint_slides():
    mast = Articulation(
        ("mast",), (Joint("mast", "prismatic", 0, 5, 0.0, (Stage("prismatic", ("mast",), (0, 1, 0)),)),)
    )
    np.testing.assert_allclose(land(mast, pose(scale_px=2, joints=(1.5,)), "mast", (1, 1, 1)), [2, 5, 2], atol=1e-6)


@pytest.mark.parametrize("stages_reversed", [False, True])
def test_deeper_stages_are_applied_first(stages_reversed):
    """A truss (depth 0) turns 90 degrees about z, a panel on it (depth 1) 90 degrees about x through (0, 0, 0).

    (0, 1, 0) -> panel about x -> (0, 0, 1) -> truss about z -> (0, 0, 1). The other way round: (0, 1, 0) ->
    (-1, 0, 0) -> (-1, 0, 0).
    """
    truss = Joint("truss", "revolute", 0, 360, 0.0, (Stage("revolute", ("truss", "panel"), (0, 0, 1)),))
    panel = Joint("panel", "revolute", 0, 360, 0.0, (Stage("revolute", ("panel",), (1, 0, 0), depth=1),))
    joints = (panel, truss) if stages_reversed else (truss, panel)
    articulation = Articulation(("truss", "panel"), joints)
    poses = pose(joints=(90.0, 90.0))
    np.testing.assert_allclose(land(articulation, poses, "panel", (0, 1, 0)), [0, 0, 1], atol=1e-6)
    np.testing.assert_allclose(land(articulation, poses, "truss", (0, 1, 0)), [-1, 0, 0], atol=1e-6)


def test_one_joint_may_drive_two_stages():
    """Both wings of a satellite turn by the same value, about their own hinges."""
    both = Joint(
        "wings",
        "revolute",
        -180,
        180,
        0.0,
        (Stage("revolute", ("left",), (1, 0, 0)), Stage("revolute", ("right",), (-1, 0, 0))),
    )
    articulation = Articulation(("left", "right"), (both,))
    poses = pose(joints=(90.0,))
    np.testing.assert_allclose(land(articulation, poses, "left", (0, 1, 0)), [0, 0, 1], atol=1e-6)
    np.testing.assert_allclose(land(articulation, poses, "right", (0, 1, 0)), [0, 0, -1], atol=1e-6)


def test_transforms_are_contiguous_float32_for_the_device():
    out = part_transforms(BUS_AND_PANEL, pose(joints=(3.0,)))
    assert out.shape == (1, 2, 3, 4)
    assert out.dtype == np.float32
    assert out.flags.c_contiguous


def test_stage_motion_is_rigid():
    axis = np.array([2.0, -1.0, 2.0]) / 3
    motion = stage_motion(Stage("revolute", ("p",), tuple(axis), (0.5, -2.0, 3.0)), np.linspace(-300, 300, 7))
    rotation = motion[:, :3, :3]
    np.testing.assert_allclose(rotation @ rotation.swapaxes(1, 2), np.tile(np.eye(3), (7, 1, 1)), atol=1e-14)
    np.testing.assert_allclose(np.linalg.det(rotation), 1)
    on_axis = np.array([0.5, -2.0, 3.0]) + 1.7 * axis
    np.testing.assert_allclose(motion @ [*on_axis, 1.0], np.tile([*on_axis, 1.0], (7, 1)), atol=1e-13)


THREE = Articulation(
    ("a", "b", "c"),
    tuple(
        Joint(name, "revolute", -90, 90, initial, (Stage("revolute", (name,), (0, 0, 1)),))
        for name, initial in (("a", 0.0), ("b", 10.0), ("c", 20.0))
    ),
)


def names(articulation: Articulation) -> list[str]:
    return [joint.name for joint in articulation.joints]


def held(articulation: Articulation) -> dict[str, float]:
    return {joint.name: value for joint, value in articulation.held}


def test_hold_keeps_the_order_of_the_joints_that_stay_free():
    found = hold(THREE, ("c", "a"), {})
    assert names(found) == ["a", "c"]
    assert held(found) == {"b": 10.0}
    np.testing.assert_array_equal(found.initial, [0, 20])


def test_hold_all_but_the_fixed_ones():
    found = hold(THREE, "all", {"b": -45.0})
    assert names(found) == ["a", "c"]
    assert held(found) == {"b": -45.0}


def test_hold_nothing_free_leaves_everything_at_rest():
    found = hold(THREE, (), {})
    assert found.n_joints == 0
    assert held(found) == {"a": 0.0, "b": 10.0, "c": 20.0}


def test_held_joints_still_move_their_parts():
    everything = part_transforms(THREE, pose(joints=(15.0, -45.0, 20.0)))
    some = part_transforms(hold(THREE, ("a",), {"b": -45.0}), pose(joints=(15.0,)))
    np.testing.assert_allclose(some, everything, atol=1e-6)


def test_holding_twice_forgets_nothing():
    found = hold(hold(THREE, ("a", "c"), {"b": -45.0}), ("a",), {})
    assert names(found) == ["a"]
    assert held(found) == {"b": -45.0, "c": 20.0}


@pytest.mark.parametrize(
    ("free", "fixed", "message"),
    [
        (("wing",), {}, "no joint 'wing'; it has a, b, c"),
        ("all", {"wing": 0.0}, "no joint 'wing'"),
        (("a",), {"a": 0.0}, "both free and fixed"),
        ("all", {"a": 91.0}, "moves from -90 to 90"),
        ("all", {"a": float("nan")}, "moves from -90 to 90"),
    ],
)
def test_hold_says_what_is_wrong(free, fixed, message):
    with pytest.raises(ValueError, match=message):
        hold(THREE, free, fixed)


def test_hold_on_a_rigid_body():
    assert hold(Articulation(("bus",)), "all", {}).n_joints == 0
    with pytest.raises(ValueError, match="it has none"):
        hold(Articulation(("bus",)), ("wing",), {})

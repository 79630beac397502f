"""Models made to cost: what is too much is refused by name before work begins, and what is let in costs a known sum."""

import dataclasses
import json

import numpy as np
import pytest

from gpu.mesh import assemble
from gpu.mesh_limits import MeshLimits
from gpu.raw_part import RawPart
from service.errors import JointError, MeshFileError, TooLargeError
from service.inference.articulation import Articulation, Joint, Stage, part_transforms
from service.inference.state import Poses
from service.models import silhouettes
from service.models.symmetry import model_symmetries
from service.simulate.glb_writer import Hinge, SolidNode, _container, write_glb
from service.simulate.primitives import box
from service.workers.base import ModelJob
from service.workers.preparing import report_model

SMALL = MeshLimits(joints=3, moves=4)
BRICK = box((1.0, 2.0, 3.0))


def mesh_of(*names: str):
    solids = {name: BRICK.moved((3.0 * k, 0.0, 0.0)) for k, name in enumerate(names)}
    return assemble([RawPart(name, np.asarray(s.vertices, float), np.asarray(s.faces)) for name, s in solids.items()])


def requested(mesh, joints, limits=SMALL):
    return report_model(ModelJob(b"", "obj", tuple(joints)), mesh, limits).articulation


def joint(name="j", parts=("a",), **more):
    return {"name": name, "parts": list(parts), "axis": [1, 0, 0], **more}


def glb(articulations: int, stages: int) -> bytes:
    nodes = [SolidNode(f"n{k}", BRICK, (3.0 * k, 0.0, 0.0), Hinge(f"a{k}", "x")) for k in range(articulations)]
    data = write_glb("r", nodes)
    length = int.from_bytes(data[12:16], "little")
    tree = json.loads(data[20 : 20 + length])
    for k, one in enumerate(tree["extensions"]["AGI_articulations"]["articulations"]):
        one["stages"] = [{**one["stages"][0], "name": f"s{s}"} for s in range(stages)]
        tree["nodes"][k]["extensions"] = {"AGI_articulations": {"articulationName": one["name"]}}  # the root, too
    return _container(tree, data[20 + length + 8 :])


@pytest.mark.parametrize(("shape", "setting"), [((2, 2), "JOINTS"), ((1, 3), "MOVES")])
def test_joints_of_a_file_are_counted_before_they_are_placed(shape, setting):
    data = glb(*shape)
    mesh = mesh_of(*(f"n{k}" for k in range(shape[0])))
    with pytest.raises(TooLargeError) as refusal:
        report_model(ModelJob(data, "glb"), mesh, SMALL)
    assert refusal.value.facts["setting"] == f"SKYPOSE_MAX_MODEL_{setting}"
    assert refusal.value.facts["found"] > refusal.value.facts["limit"]
    assert report_model(ModelJob(glb(1, 2), "glb"), mesh_of("n0"), SMALL).articulation.n_joints == 2


@pytest.mark.parametrize(
    ("joints", "setting"),
    [
        ([joint(str(k)) for k in range(4)], "JOINTS"),
        ([joint(str(k), ("a", "b")) for k in range(3)], "MOVES"),
    ],
)
def test_joints_of_a_request_are_counted(joints, setting):
    with pytest.raises(TooLargeError) as refusal:
        requested(mesh_of("a", "b"), joints)
    assert refusal.value.facts["setting"] == f"SKYPOSE_MAX_MODEL_{setting}"


def test_joints_of_a_robot_are_counted():
    links = "".join(
        f'<link name="l{k}"><visual><geometry><box size="1 1 1"/></geometry></visual></link>' for k in range(5)
    )
    chain = "".join(
        f'<joint name="j{k}" type="continuous"><parent link="l{k}"/><child link="l{k + 1}"/></joint>' for k in range(4)
    )
    data = f'<robot name="r">{links}{chain}</robot>'.encode()
    mesh = mesh_of(*(f"l{k}" for k in range(5)))
    for limits, setting in ((SMALL, "JOINTS"), (dataclasses.replace(SMALL, joints=4), "MOVES")):
        with pytest.raises(TooLargeError) as refusal:
            report_model(ModelJob(data, "urdf"), mesh, limits)
        assert refusal.value.facts["setting"] == f"SKYPOSE_MAX_MODEL_{setting}"


def test_a_body_too_intricate_to_search_is_taken_with_a_warning(monkeypatch):
    mesh = mesh_of("a", "b")
    articulation = requested(mesh, [joint(parts=("b",))])
    assert model_symmetries(mesh, articulation).symmetries
    monkeypatch.setattr(silhouettes, "MOST_WORK", 3e7)
    found = model_symmetries(mesh, articulation)
    assert (found.symmetries, found.joint_periods) == ((), (articulation.joints[0].period,))
    assert "too intricate" in found.warnings[0]
    assert "1 joints" in found.warnings[0]


def test_faces_that_are_always_small_are_drawn_by_their_corners_to_the_same_picture():
    rng = np.random.default_rng(1)
    corners = rng.uniform(-1, 1, (400, 1, 3)) + rng.choice([0.005, 0.3], (400, 1, 1)) * rng.normal(size=(400, 3, 3))
    mesh = assemble([RawPart("soup", corners.reshape(-1, 3), np.arange(1200).reshape(-1, 3))])
    views = silhouettes.Silhouettes(mesh, Articulation(("soup",)), 4)
    poses = views.poses(np.zeros(0), silhouettes.Target(np.zeros(3), mesh.radius))
    large, small = views._split([0], float(np.exp(poses.log_scale[0])))
    assert 0 < len(large) < mesh.n_faces
    assert len(small) > 0
    drawn = views.draw(poses)
    views._edges = [np.full(mesh.n_faces, np.inf)]  # every face as one that may be large
    np.testing.assert_array_equal(drawn, views.draw(poses))


def test_a_part_that_a_joint_names_twice_moves_once():
    mesh = mesh_of("a", "b")
    stages = requested(mesh, [joint(parts=("a", "a"), origin=[9, 9, 9])]).joints[0].stages
    assert stages[0].parts == ("a",)
    stored = Articulation(("a",), (Joint("j", "revolute", -180, 180, 0, (Stage("revolute", ("a", "a"), (1, 0, 0)),)),))
    poses = Poses(np.array([[1.0, 0, 0, 0]]), np.zeros((1, 2)), np.zeros(1), np.array([[90.0]]))
    np.testing.assert_allclose(part_transforms(stored, poses)[0, 0, 1, :3], [0, 0, -1], atol=1e-6)


@pytest.mark.parametrize(
    ("change", "field"),
    [
        ({"origin": [1e300, 0, 0]}, "joints[0].origin"),
        ({"origin": [1e6, 0, 0]}, "joints"),
        ({"axis": [1e300, 0, 0]}, "joints[0].axis"),
        ({"kind": "prismatic", "min": 0, "max": 1e9}, "joints"),
        ({"max": 1e300}, "joints[0].max"),
        ({"name": "n" * 256}, "joints[0].name"),
        ({"parts": [["a"]]}, "joints[0].parts"),
    ],
)
def test_a_joint_beyond_all_bounds_is_refused_by_name(change, field):
    with pytest.raises(JointError) as refusal:
        requested(mesh_of("a"), [joint(**change)])
    assert refusal.value.field == field


def test_a_part_of_an_endless_name_is_refused():
    from service.workers.decoding import InPlace

    with pytest.raises(MeshFileError, match="longer than 255"):
        InPlace().parts(write_glb("r", [SolidNode("n" * 256, BRICK)]), "glb")


@pytest.mark.parametrize(
    ("field", "value"),
    [("rotation", "all"), ("rotation", [0, 0, 1]), ("matrix", [1, 2]), ("translation", {}), ("scale", "x")],
)
def test_a_node_whose_place_is_no_transform_is_the_files_fault(field, value):
    data = glb(1, 1)
    length = int.from_bytes(data[12:16], "little")
    tree = json.loads(data[20 : 20 + length])
    tree["nodes"][0][field] = value
    with pytest.raises(MeshFileError, match="node tree"):
        report_model(ModelJob(_container(tree, b""), "glb"), mesh_of("n0"), SMALL)


@pytest.mark.parametrize("value", ["x", [], 7])
def test_extensions_of_another_kind_are_none(value):
    data = glb(1, 1)
    length = int.from_bytes(data[12:16], "little")
    tree = json.loads(data[20 : 20 + length])
    tree["nodes"][0]["extensions"] = value
    assert report_model(ModelJob(_container(tree, b""), "glb"), mesh_of("n0"), SMALL).articulation.n_joints == 1
    tree["extensions"] = value
    assert report_model(ModelJob(_container(tree, b""), "glb"), mesh_of("n0"), SMALL).articulation.n_joints == 0


def test_one_kind_of_warning_does_not_fill_the_answer():
    mesh = dataclasses.replace(mesh_of("a"), warnings=tuple(f"warning {k}" for k in range(500)))
    told = report_model(ModelJob(b"", "obj"), mesh, SMALL).warnings
    assert "and 400 more warnings like these" in told
    assert len(told) < 120

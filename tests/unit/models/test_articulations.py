"""Joints: equal to the reference evaluation, to hand-made trees, and refused with a name when broken."""

import json
import struct
from pathlib import Path

import numpy as np
import pytest
import trimesh

from gpu.mesh import Mesh, Part
from service.errors import JointError
from service.inference.articulation import Articulation, part_transforms
from service.inference.state import Poses
from service.models.articulations import read_joints

MESHES = Path(__file__).resolve().parents[4] / "shared" / "data" / "meshes"


def raw_mesh(path_or_parts) -> Mesh:
    """A mesh as in the file, not prepared: vertices must stay comparable one to one."""
    if isinstance(path_or_parts, Path):
        scene = trimesh.load(path_or_parts, force="scene")
        found = {}
        for node in scene.graph.nodes_geometry:
            transform, geometry = scene.graph[node]
            piece = scene.geometry[geometry].copy()
            piece.apply_transform(transform)
            found[node] = piece
    else:
        found = path_or_parts
    vertices = np.vstack([m.vertices for m in found.values()])
    centre = (vertices.min(0) + vertices.max(0)) / 2
    parts = tuple(Part(n, m.vertices - centre, m.faces.astype(np.int32)) for n, m in found.items())
    return Mesh(parts, tuple(centre), tuple(np.ptp(vertices, axis=0)), 1.0, True)


def posed(mesh: Mesh, articulation: Articulation, values: dict[str, float]) -> dict[str, np.ndarray]:
    column = articulation.initial
    for i, joint in enumerate(articulation.joints):
        column[i] = values.get(joint.name, column[i])
    pose = Poses(np.array([[1.0, 0, 0, 0]]), np.zeros((1, 2)), np.zeros(1), column[None])
    motions = part_transforms(articulation, pose)[0].astype(np.float64)
    return {p.name: p.vertices @ m[:, :3].T + m[:, 3] for p, m in zip(mesh.parts, motions, strict=True)}


def reference(mesh: Mesh, joints: list[dict], values: dict[str, float]) -> dict[str, np.ndarray]:
    """The joints one after the other in file coordinates, with trimesh's own rotation matrix."""
    out = {}
    for part in mesh.parts:
        v = part.vertices + mesh.centre
        for joint in joints:
            if part.name in joint["parts"] and joint["name"] in values:
                if joint["kind"] == "prismatic":
                    v = v + np.asarray(joint["axis"]) * values[joint["name"]]
                else:
                    angle = np.deg2rad(values[joint["name"]])
                    m = trimesh.transformations.rotation_matrix(angle, joint["axis"], joint["origin"])
                    v = v @ m[:3, :3].T + m[:3, 3]
        out[part.name] = v - mesh.centre
    return out


def shared_mesh(name: str) -> tuple[Mesh, bytes, dict]:
    path = MESHES / name
    if not path.exists():
        pytest.skip(f"{path} is not there: the shared data stand beside the checkout")
    facts = next(m for m in json.loads((MESHES / "meshes.json").read_text()) if m["file"] == name)
    return raw_mesh(path), path.read_bytes(), facts


def contract_joints(mesh: Mesh, tree_children: dict[str, list[str]], facts: dict) -> list[dict]:
    """The hinge table of meshes.json in the contract's form, deeper nodes first."""
    out = []
    for joint in facts["articulations"]:
        axis = np.eye(3)["xyz".index(joint["axis"])].tolist()
        for hinge in joint["nodes"]:
            parts = [hinge["node"], *tree_children.get(hinge["node"], [])]
            entry = {"name": joint["name"], "kind": "revolute", "parts": parts, "axis": axis}
            out.append(entry | {"origin": hinge["hinge_point"]})
    return sorted(out, key=lambda j: len(j["parts"]))


def test_listed_order_is_the_order_of_application():
    box = trimesh.creation.box((1, 1, 1))
    mesh = raw_mesh({"a": box, "b": box.copy().apply_translation((3, 0, 0))})
    joints = [
        {"name": "slide", "kind": "prismatic", "parts": ["b"], "axis": [0, 2, 0], "min": 0, "max": 5},
        {"name": "turn", "kind": "revolute", "parts": ["b"], "axis": [0, 0, 3], "origin": [1.0, 0.5, 0]},
        {"name": "tilt", "kind": "revolute", "parts": ["a", "b"], "axis": [1, 0, 0], "origin": [0, 1, 0]},
        # a joint that cannot turn all the way round has no period
        {"name": "flap", "kind": "revolute", "parts": ["a"], "axis": [1, 0, 0], "min": -90, "max": 90},
    ]
    articulation = read_joints(b"", "obj", mesh, joints).articulation
    values = {"slide": 0.7, "turn": 35.0, "tilt": -20.0}
    unit = [{**j, "axis": np.asarray(j["axis"]) / np.linalg.norm(j["axis"])} for j in joints]
    got, want = posed(mesh, articulation, values), reference(mesh, unit, values)
    for name in want:
        np.testing.assert_allclose(got[name], want[name], atol=1e-6)
    assert [j.period for j in articulation.joints] == [None, 360.0, 360.0, None]


@pytest.mark.parametrize(
    ("change", "field"),
    [
        ({"name": ""}, "joints[0].name"),
        ({"kind": "ball"}, "joints[0].kind"),
        ({"parts": ["nowhere"]}, "joints[0].parts"),
        ({"parts": []}, "joints[0].parts"),
        ({"axis": [0, 0, 0]}, "joints[0].axis"),
        ({"axis": [0, 1]}, "joints[0].axis"),
        ({"origin": [0, float("nan"), 0]}, "joints[0].origin"),
        ({"min": 10, "max": -10}, "joints[0].min"),
        ({"initial": 200}, "joints[0].initial"),
        ({"speed": 1}, "joints[0].speed"),
        ({"kind": "prismatic", "min": None}, "joints[0].min"),
    ],
)
def test_a_broken_joint_is_refused_by_name(change, field):
    mesh = raw_mesh({"a": trimesh.creation.box((1, 1, 1))})
    joint = {"name": "j", "kind": "revolute", "parts": ["a"], "axis": [1, 0, 0], **change}
    with pytest.raises(JointError) as caught:
        read_joints(b"", "obj", mesh, [joint])
    assert caught.value.field == field


def test_two_joints_of_one_name_are_refused():
    mesh = raw_mesh({"a": trimesh.creation.box((1, 1, 1))})
    joint = {"name": "j", "kind": "revolute", "parts": ["a"], "axis": [1, 0, 0]}
    with pytest.raises(JointError, match="used twice"):
        read_joints(b"", "obj", mesh, [joint, joint])


def glb(document: dict) -> bytes:
    text = json.dumps(document).encode()
    text += b" " * (-len(text) % 4)
    header = struct.pack("<4sII", b"glTF", 2, 20 + len(text))
    return header + struct.pack("<I4s", len(text), b"JSON") + text


def scene_document(stages: list[dict], **node) -> dict:
    arm = {"articulationName": "Arm"}
    return {
        "nodes": [
            {"name": "root", "children": [1]},
            {"name": "arm", "children": [2], **node, "extensions": {"AGI_articulations": arm}},
            {"name": "hand", "translation": [1, 0, 0]},
        ],
        "extensions": {"AGI_articulations": {"articulations": [{"name": "Arm", "stages": stages}]}},
    }


def stage(kind: str, low: float = -180.0, high: float = 180.0, initial: float = 0.0) -> dict:
    return {"name": kind, "type": kind, "minimumValue": low, "maximumValue": high, "initialValue": initial}


def test_stages_act_after_the_nodes_transform_the_last_one_first():
    half = np.sqrt(0.5)
    document = scene_document(
        [stage("yRotate"), stage("xRotate", 0, 90, 30), stage("xTranslate", 0, 2)],
        translation=[0, 0, 5],
        rotation=[0, 0, half, half],
        scale=[2, 2, 2],
    )
    box = trimesh.creation.box((1, 1, 1))
    mesh = raw_mesh({"root": box, "arm": box.copy().apply_translation((1, 2, 5)), "hand": box.copy()})
    model = read_joints(glb(document), "glb", mesh)
    names = [j.name for j in model.articulation.joints]
    assert names == ["Arm yRotate", "Arm xRotate", "Arm xTranslate"]
    assert model.articulation.joints[1].initial == 30
    assert model.articulation.joints[2].maximum == pytest.approx(4)  # two node units are four model units

    values = {"Arm yRotate": 25.0, "Arm xRotate": 40.0, "Arm xTranslate": 1.5}
    node = np.array([[0, -2, 0, 0], [2, 0, 0, 0], [0, 0, 2, 5], [0, 0, 0, 1.0]])
    turn = trimesh.transformations.rotation_matrix
    local = turn(np.deg2rad(25), [0, 1, 0]) @ turn(np.deg2rad(40), [1, 0, 0])
    local = local @ trimesh.transformations.translation_matrix([1.5 / 2, 0, 0])
    motion = node @ local @ np.linalg.inv(node)
    got = posed(mesh, model.articulation, values)
    for part in mesh.parts:
        v = part.vertices + mesh.centre
        want = v if part.name == "root" else v @ motion[:3, :3].T + motion[:3, 3]
        np.testing.assert_allclose(got[part.name], want - mesh.centre, atol=1e-5)


def test_scale_stages_and_skewed_nodes_are_left_out_with_a_warning():
    box = trimesh.creation.box((1, 1, 1))
    mesh = raw_mesh({"arm": box, "hand": box.copy()})
    model = read_joints(glb(scene_document([stage("uniformScale"), stage("xRotate")])), "glb", mesh)
    assert [j.name for j in model.articulation.joints] == ["Arm"]
    assert "changes the size" in model.warnings[0]
    model = read_joints(glb(scene_document([stage("xRotate")], scale=[1, 2, 1])), "glb", mesh)
    assert model.articulation.joints == ()
    assert "rigidly" in model.warnings[0]


def test_a_pointing_vector_is_ignored_with_a_warning():
    box = trimesh.creation.box((1, 1, 1))
    mesh = raw_mesh({"arm": box, "hand": box.copy()})
    document = scene_document([stage("xRotate")])
    (articulation,) = document["extensions"]["AGI_articulations"]["articulations"]
    articulation["pointingVector"] = [1, 0, 0]
    model = read_joints(glb(document), "glb", mesh)
    assert [j.name for j in model.articulation.joints] == ["Arm"]
    assert "pointing vector" in model.warnings[0]


def test_the_drives_of_a_station_become_two_variables():
    """All ten wings of the ISS: the two alpha joints turn against each other, the eight beta joints alike."""
    mesh, data, _ = shared_mesh("iss.glb")
    free = read_joints(data, "glb", mesh).articulation
    betas = [joint.name for joint in free.joints if joint.name.startswith("Beta_")]
    ties = [{"name": "Alpha_starboard", "tied_to": "Alpha_port", "ratio": -1}]
    ties += [{"name": name, "tied_to": betas[0]} for name in betas[1:]]
    tied = read_joints(data, "glb", mesh, ties).articulation
    assert [joint.name for joint in tied.joints[:2]] == ["Alpha_port", betas[0]]
    assert tied.n_joints == free.n_joints - 8
    together = posed(mesh, tied, {"Alpha_port": 35.0, betas[0]: -70.0})
    apart = posed(mesh, free, {"Alpha_port": 35.0, "Alpha_starboard": -35.0, **dict.fromkeys(betas, -70.0)})
    for name, vertices in apart.items():
        np.testing.assert_allclose(together[name], vertices, atol=1e-5)


@pytest.mark.parametrize("name", ["hubble", "topex_poseidon", "mdlsat", "suomi_npp", "iss"])
def test_articulations_in_the_file_equal_the_published_hinges(name):
    mesh, data, facts = shared_mesh(f"{name}.glb")
    model = read_joints(data, "glb", mesh)
    children = {"truss_port": [f"panel_port_{i}" for i in range(1, 5)]}
    children["truss_starboard"] = [f"panel_starboard_{i}" for i in range(1, 5)]
    joints = contract_joints(mesh, children if name == "iss" else {}, facts)
    rng = np.random.default_rng(3)
    values = {j.name: float(rng.uniform(j.minimum, j.maximum)) for j in model.articulation.joints}
    assert set(values) == {j["name"] for j in joints}
    got, want = posed(mesh, model.articulation, values), reference(mesh, joints, values)
    reach = max(mesh.size)
    for part in want:
        np.testing.assert_allclose(got[part], want[part], atol=1e-6 * reach)


def test_hubble_is_one_joint_with_two_stages():
    mesh, data, _ = shared_mesh("hubble.glb")
    (joint,) = read_joints(data, "glb", mesh).articulation.joints
    assert [s.parts for s in joint.stages] == [("array_minus_x",), ("array_plus_x",)]
    assert joint.period == 360.0


def test_joints_given_with_the_upload_replace_those_in_the_file():
    mesh, data, _ = shared_mesh("topex_poseidon.glb")
    assert read_joints(data, "glb", mesh, []).articulation.joints == ()

"""Mesh files: what is read, what is repaired, and what is refused with a reason."""

import struct
import sys
from pathlib import Path

import numpy as np
import pytest
import trimesh

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "gpu"))

from gpu_cases import box, glb, mesh_of, triangle_tree

from gpu.mesh import MeshError, load_mesh


def stl(n_declared: int, n_faces: int) -> bytes:
    return b"\0" * 80 + struct.pack("<I", n_declared) + b"\0" * 50 * n_faces


def exported(file_type: str, vertices=None, faces=None) -> bytes:
    v, f = box((4, 2, 1), (10, 0, 0)) if vertices is None else (vertices, faces)
    data = trimesh.Trimesh(v, f, process=False).export(file_type=file_type)
    return data if isinstance(data, bytes) else data.encode()


@pytest.mark.parametrize("file_type", ["glb", "obj", "stl", "ply", "GLB", ".stl"])
def test_every_type_is_read_and_centred(file_type):
    mesh = load_mesh(exported(file_type.lower().lstrip(".")), file_type)
    assert mesh.n_faces == 12
    assert mesh.n_vertices == 8
    assert np.allclose(mesh.centre, (10, 0, 0))
    assert np.allclose(mesh.size, (4, 2, 1))
    assert mesh.radius == pytest.approx(np.linalg.norm([2, 1, 0.5]))
    assert mesh.watertight
    assert mesh.warnings == ()


def test_a_node_is_a_part_with_its_transform_applied():
    tree, binary = triangle_tree(
        nodes=[
            {"name": "bus", "mesh": 0, "children": [1]},
            {"name": "panel", "mesh": 0, "translation": [0, 0, 5], "scale": [2, 2, 2]},
        ],
    )
    mesh = load_mesh(glb(tree, binary), "glb")
    assert {part.name for part in mesh.parts} == {"bus", "panel"}
    panel = next(part for part in mesh.parts if part.name == "panel")
    assert np.allclose(np.ptp(panel.vertices, axis=0), [2, 2, 0])
    assert np.allclose(mesh.size, (2, 2, 5))
    assert not mesh.watertight


def test_a_mesh_of_two_primitives_is_one_part():
    primitive = {"attributes": {"POSITION": 0}, "indices": 1}
    tree, binary = triangle_tree(meshes=[{"primitives": [primitive, primitive]}])
    mesh = load_mesh(glb(tree, binary), "glb")
    assert [part.name for part in mesh.parts] == ["body"]
    assert mesh.n_faces == 1
    assert "duplicate" in mesh.warnings[0]


def test_repairs_are_made_and_reported():
    vertices, faces = box()
    doubled = np.vstack([faces, faces[:3], [[0, 0, 1]], [[0, 1, 1]]])
    mesh = mesh_of((np.vstack([vertices, vertices]), np.vstack([doubled, faces[3:5] + 8])))
    assert mesh.n_faces == 12
    assert mesh.n_vertices == 8
    assert mesh.warnings == ("part 'part0': 2 faces without area dropped", "part 'part0': 5 duplicate faces dropped")


def test_a_sliver_on_a_straight_line_is_without_area():
    points = np.array([[0, 0, 0], [1, 1, 1], [3, 3, 3], [0, 1, 0]], float)
    assert mesh_of((points, [[0, 1, 2], [0, 1, 3]])).n_faces == 1


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        ({"buffers": [{"byteLength": 48, "uri": "http://example.org/b.bin"}]}, "external file"),
        ({"buffers": [{"byteLength": 48, "uri": "../../etc/passwd"}]}, "external file"),
        ({"images": [{"uri": "file:///etc/passwd"}]}, "external file"),
        ({"nodes": [{"mesh": 0, "children": [0]}]}, "cycle"),
        ({"nodes": [{"mesh": 0, "children": [1]}, {"children": [2]}, {"children": [1]}]}, "more than one parent"),
        ({"nodes": [{"mesh": 0}, {"children": [2]}, {"children": [1]}]}, "cycle"),
        ({"nodes": [{"mesh": 0, "children": [7]}]}, "does not exist"),
        ({"nodes": [{"children": [k + 1]} for k in range(500)] + [{"mesh": 0}]}, "deeper than"),
        ({"extensionsRequired": ["EXT_meshopt_compression"]}, "meshopt"),
        ({"meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "mode": 6}]}]}, "triangle fan"),
        ({"meshes": []}, "no faces"),
        ({"accessors": []}, "does not exist"),
        ({"nodes": [{"name": "empty"}]}, "no faces"),
    ],
)
def test_a_bad_glb_is_refused_with_its_reason(change, reason):
    tree, binary = triangle_tree(**change)
    with pytest.raises(MeshError, match=reason):
        load_mesh(glb(tree, binary), "glb")


@pytest.mark.parametrize("value", [np.nan, np.inf, 1e30])
def test_a_coordinate_that_is_no_place_is_refused(value):
    tree, _ = triangle_tree()
    positions = np.array([[0, 0, 0], [1, 0, 0], [0, value, 0]], np.float32)
    with pytest.raises(MeshError, match=r"'body': a (vertex|coordinate)"):
        load_mesh(glb(tree, positions.tobytes() + np.arange(3, dtype=np.uint32).tobytes()), "glb")


def test_an_index_out_of_range_is_refused():
    tree, binary = triangle_tree()
    with pytest.raises(MeshError, match="vertex 9 of 3"):
        load_mesh(glb(tree, binary[:36] + np.array([0, 1, 9], np.uint32).tobytes()), "glb")


@pytest.mark.parametrize(
    ("data", "file_type", "reason"),
    [
        (b"", "stl", "empty"),
        (b"not a mesh at all", "glb", "magic"),
        (b"solid ", "stl", "84-byte header"),
        (stl(1_000_000_000, 1), "stl", "1000000000 faces"),
        (stl(1, 3), "stl", "declares 1 faces"),
        (stl(2, 2), "stl", "no face with an area"),
        (b"v 0 0 0\nv 1 0 0\nf 1 2\n", "obj", "no faces"),
        (b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 9\n", "obj", "cannot be read|of 3"),
        (b"ply\nformat ascii 1.0\nelement vertex 5\n", "ply", "cannot be read"),
        (b"x", "fbx", "fbx.*not one of glb, obj, stl, ply"),
    ],
)
def test_other_bad_files_are_refused_with_their_reason(data, file_type, reason):
    with pytest.raises(MeshError, match=reason):
        load_mesh(data, file_type)


def test_a_truncated_glb_is_refused():
    whole = glb(*triangle_tree())
    for length in (0, 3, 11, 19, 60, len(whole) - 1):
        with pytest.raises(MeshError):
            load_mesh(whole[:length], "glb")


@pytest.mark.parametrize("position", range(0, 400, 7))
def test_a_damaged_glb_is_read_or_refused_but_nothing_else_happens(position):
    whole = bytearray(glb(*triangle_tree()))
    whole[position % len(whole)] ^= 0x5A
    try:
        load_mesh(bytes(whole), "glb")
    except MeshError as refusal:
        assert str(refusal)


def test_objects_of_an_obj_are_parts_in_the_order_of_the_file():
    corner = "v {0} 0 0\nv {1} 0 0\nv {0} 1 0\nv {0} 0 1\n"
    faces = ((1, 3, 2), (1, 2, 4), (1, 4, 3), (2, 3, 4))
    lines = []
    for n, name in enumerate(("bus", "left wing", "boom")):
        lines.append(f"o {name}\n" + corner.format(3 * n, 3 * n + 1))
        lines += ["f {} {} {}\n".format(*(4 * n + corner for corner in face)) for face in faces]
    mesh = load_mesh("".join(lines).encode(), "obj")
    assert [part.name for part in mesh.parts] == ["bus", "left wing", "boom"]
    assert [len(part.faces) for part in mesh.parts] == [4, 4, 4]

"""Meshes that a GLB holds compressed: the same body, or refused with what is wrong."""

import sys
from pathlib import Path

import DracoPy
import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "gpu"))

from gpu_cases import box, glb

from gpu.mesh import MeshError, load_mesh

NAME = "KHR_draco_mesh_compression"


def packed(count: int | None = None, position: int = 0, view: int = 0, length: int | None = None, mode: int = 4):
    """The JSON and the binary chunk of a GLB whose box is compressed, both as the file may lie about them."""
    points, faces = box((4, 2, 1), (10, 0, 0))
    data = DracoPy.encode(points.astype(np.float32), faces.astype(np.uint32), preserve_order=True)
    length = len(data) if length is None else length
    extension = {NAME: {"bufferView": view, "attributes": {"POSITION": position}}}
    primitive = {"attributes": {"POSITION": 0}, "indices": 1, "mode": mode, "extensions": extension}
    tree = {
        "asset": {"version": "2.0"},
        "extensionsUsed": [NAME],
        "extensionsRequired": [NAME],
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0, "name": "body"}],
        "meshes": [{"primitives": [primitive]}],
        "buffers": [{"byteLength": len(data)}],
        "bufferViews": [{"buffer": 0, "byteLength": length}],
        "accessors": [
            {"componentType": 5126, "count": count or len(points), "type": "VEC3"},
            {"componentType": 5125, "count": 3 * len(faces), "type": "SCALAR"},
        ],
    }
    return tree, data + b"\0" * (-len(data) % 4)


def test_a_compressed_body_is_the_body():
    mesh = load_mesh(glb(*packed()), "glb")
    assert [part.name for part in mesh.parts] == ["body"] and (mesh.n_faces, mesh.n_vertices) == (12, 8)
    assert np.allclose(mesh.size, (4, 2, 1), atol=1e-3) and np.allclose(mesh.centre, (10, 0, 0), atol=1e-3)
    assert mesh.watertight and mesh.warnings == ()


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        ({"count": 9}, "hold 8 vertices and 36 indices; the file states 9 and 36"),
        ({"position": 7}, "hold no positions"),
        ({"view": 3}, "not in the binary chunk"),
        ({"length": 1 << 20}, "not in the binary chunk"),
        ({"length": 12}, "cannot be decoded"),
        ({"mode": 5}, "are no triangles"),
    ],
)
def test_compressed_data_that_are_not_what_the_file_states_are_refused(change, reason):
    with pytest.raises(MeshError, match=reason):
        load_mesh(glb(*packed(**change)), "glb")


def test_a_cloud_of_points_is_no_mesh():
    tree, _ = packed()
    points, _ = box()
    data = DracoPy.encode(points.astype(np.float32), preserve_order=True)
    tree["bufferViews"] = [{"buffer": 0, "byteLength": len(data)}]
    tree["buffers"] = [{"byteLength": len(data)}]
    with pytest.raises(MeshError, match="hold no faces"):
        load_mesh(glb(tree, data), "glb")

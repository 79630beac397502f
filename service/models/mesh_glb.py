"""A prepared mesh as binary glTF 2.0: what the tracker sees, for whoever wants to draw it."""

from __future__ import annotations

import json
import struct
from typing import Any

from gpu.mesh import Mesh, Part

_FLOAT, _UNSIGNED_INT = 5126, 5125
_ARRAY_BUFFER, _ELEMENT_ARRAY_BUFFER = 34962, 34963


def mesh_glb(mesh: Mesh, root: tuple[float, float, float, float] | None = None) -> bytes:
    """GLB bytes: one node per part, in the order and under the names of the parts, all joints at rest.

    Coordinates are those of the body frame (model units, the centre of the bounding box at rest is the origin),
    whatever axes the uploaded file had. ``root`` (x, y, z, w): all of it is below one more node, which turns it so.
    """
    binary = bytearray()
    document: dict[str, Any] = {
        "asset": {"version": "2.0", "generator": "skypose"},
        "scene": 0,
        "scenes": [{"nodes": list(range(len(mesh.parts)))}],
        "nodes": [{"name": part.name, "mesh": i} for i, part in enumerate(mesh.parts)],
        "meshes": [],
        "accessors": [],
        "bufferViews": [],
    }
    if root is not None:
        document["nodes"].append({"name": "root", "rotation": list(root), "children": list(range(len(mesh.parts)))})
        document["scenes"] = [{"nodes": [len(mesh.parts)]}]
    for part in mesh.parts:
        document["meshes"].append(_mesh(document, binary, part))
    document["buffers"] = [{"byteLength": len(binary)}]
    return _container(document, bytes(binary))


def _mesh(document: dict[str, Any], binary: bytearray, part: Part) -> dict[str, Any]:
    positions, indices = part.vertices.astype("<f4"), part.faces.astype("<u4")
    position = {
        "bufferView": _view(document, binary, positions.tobytes(), _ARRAY_BUFFER),
        "componentType": _FLOAT,
        "count": len(positions),
        "type": "VEC3",
        "min": positions.min(axis=0).tolist(),
        "max": positions.max(axis=0).tolist(),
    }
    index = {
        "bufferView": _view(document, binary, indices.tobytes(), _ELEMENT_ARRAY_BUFFER),
        "componentType": _UNSIGNED_INT,
        "count": indices.size,
        "type": "SCALAR",
    }
    first = len(document["accessors"])
    document["accessors"] += [position, index]
    return {"primitives": [{"attributes": {"POSITION": first}, "indices": first + 1}]}


def _view(document: dict[str, Any], binary: bytearray, data: bytes, target: int) -> int:
    view = {"buffer": 0, "byteOffset": len(binary), "byteLength": len(data), "target": target}
    document["bufferViews"].append(view)
    binary.extend(data)
    return len(document["bufferViews"]) - 1


def _container(document: dict[str, Any], binary: bytes) -> bytes:
    text = json.dumps(document, separators=(",", ":")).encode()
    text += b" " * (-len(text) % 4)
    chunks = struct.pack("<I4s", len(text), b"JSON") + text + struct.pack("<I4s", len(binary), b"BIN\0") + binary
    return struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks

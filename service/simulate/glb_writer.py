"""A binary glTF 2.0 file from solids, with joints written as ``AGI_articulations``."""

from __future__ import annotations

import json
import struct
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from service.simulate.primitives import Solid, Vector

_FLOAT, _UNSIGNED_INT = 5126, 5125
_ARRAY_BUFFER, _ELEMENT_ARRAY_BUFFER = 34962, 34963


@dataclass(frozen=True)
class Hinge:
    """A rotation about one of the node's own axes."""

    articulation: str
    axis: str  # "x", "y" or "z"
    minimum_deg: float = -180.0
    maximum_deg: float = 180.0


@dataclass(frozen=True)
class SolidNode:
    """A node: a solid given relative to ``translation``, and perhaps a hinge there."""

    name: str
    solid: Solid
    translation: Vector = (0.0, 0.0, 0.0)
    hinge: Hinge | None = None


def write_glb(title: str, nodes: Sequence[SolidNode]) -> bytes:
    """The nodes under one root called ``title``, as the bytes of a GLB file."""
    binary = bytearray()
    document: dict[str, Any] = {
        "asset": {"version": "2.0", "generator": "skypose"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"name": title, "children": list(range(1, len(nodes) + 1))}],
        "meshes": [],
        "accessors": [],
        "bufferViews": [],
    }
    for i, node in enumerate(nodes):
        entry: dict[str, Any] = {"name": node.name, "mesh": i, "translation": list(node.translation)}
        if node.hinge is not None:
            entry["extensions"] = {"AGI_articulations": {"articulationName": node.hinge.articulation}}
        document["nodes"].append(entry)
        document["meshes"].append(_mesh(document, binary, node))
    hinges = [node.hinge for node in nodes if node.hinge is not None]
    if hinges:
        document["extensionsUsed"] = ["AGI_articulations"]
        document["extensions"] = {"AGI_articulations": {"articulations": [_articulation(h) for h in hinges]}}
    document["buffers"] = [{"byteLength": len(binary)}]
    return _container(document, bytes(binary))


def _mesh(document: dict[str, Any], binary: bytearray, node: SolidNode) -> dict[str, Any]:
    positions = node.solid.vertices.astype("<f4")
    indices = node.solid.faces.astype("<u4")
    bounds = {"min": positions.min(axis=0).tolist(), "max": positions.max(axis=0).tolist()}
    position = _accessor(document, binary, positions.tobytes(), _ARRAY_BUFFER) | {
        "componentType": _FLOAT,
        "count": len(positions),
        "type": "VEC3",
        **bounds,
    }
    index = _accessor(document, binary, indices.tobytes(), _ELEMENT_ARRAY_BUFFER) | {
        "componentType": _UNSIGNED_INT,
        "count": indices.size,
        "type": "SCALAR",
    }
    first = len(document["accessors"])
    document["accessors"] += [position, index]
    return {"name": node.name, "primitives": [{"attributes": {"POSITION": first}, "indices": first + 1}]}


def _accessor(document: dict[str, Any], binary: bytearray, data: bytes, target: int) -> dict[str, Any]:
    view = {"buffer": 0, "byteOffset": len(binary), "byteLength": len(data), "target": target}
    document["bufferViews"].append(view)
    binary.extend(data)
    return {"bufferView": len(document["bufferViews"]) - 1}


def _articulation(hinge: Hinge) -> dict[str, Any]:
    stage = {
        "name": "Rotate",
        "type": f"{hinge.axis}Rotate",
        "minimumValue": hinge.minimum_deg,
        "maximumValue": hinge.maximum_deg,
        "initialValue": 0.0,
    }
    return {"name": hinge.articulation, "stages": [stage]}


def _container(document: dict[str, Any], binary: bytes) -> bytes:
    text = json.dumps(document, separators=(",", ":")).encode()
    text += b" " * (-len(text) % 4)
    binary += b"\0" * (-len(binary) % 4)
    chunks = struct.pack("<I4s", len(text), b"JSON") + text + struct.pack("<I4s", len(binary), b"BIN\0") + binary
    return struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks

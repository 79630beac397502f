"""The node tree of a binary glTF file: names, who moves with whom, and where each node stands at rest."""

from __future__ import annotations

import json
import struct
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from service.errors import MeshFileError

_MAGIC = b"glTF"
_JSON_CHUNK = b"JSON"


@dataclass(frozen=True)
class Node:
    """A node of the scene. ``name`` is unique in the file, made so the way the mesh loader does."""

    name: str
    depth: int  # 0 for a root
    world: NDArray[np.float64]  # (4, 4) node -> file coordinates, at rest
    subtree: frozenset[str]  # names of this node and all its descendants
    extensions: Mapping[str, Any]


@dataclass(frozen=True)
class SceneTree:
    """All nodes of the file, in file order, and the extensions at its top level."""

    nodes: tuple[Node, ...]
    extensions: Mapping[str, Any]


def read_scene_tree(data: bytes) -> SceneTree:
    """Parse a GLB's JSON chunk (glTF 2.0, sections 3.5 and 4.4). Raises ``MeshFileError``."""
    document = _json_chunk(data)
    try:
        return _tree(document)
    except (ArithmeticError, AttributeError, LookupError, TypeError, ValueError) as error:  # of a value of another kind
        raise MeshFileError(f"the node tree of the GLB file cannot be read: {error}") from error


def _tree(document: Mapping[str, Any]) -> SceneTree:
    entries = document.get("nodes", [])
    names = _unique_names(entries)
    children = [tuple(entry.get("children", ())) for entry in entries]
    nodes: list[Node | None] = [None] * len(entries)
    is_child = {child for group in children for child in group}
    pending = [(i, 0, np.eye(4)) for i in range(len(entries)) if i not in is_child]
    while pending:
        i, depth, parent = pending.pop()
        if not 0 <= i < len(entries) or nodes[i] is not None:
            raise MeshFileError("the nodes of the file form no tree")
        world = parent @ local_matrix(entries[i])
        subtree = frozenset(names[k] for k in _descendants(children, i))
        nodes[i] = Node(names[i], depth, world, subtree, _extensions(entries[i]))
        pending.extend((child, depth + 1, world) for child in children[i])
    if None in nodes:
        raise MeshFileError("the nodes of the file form a cycle")
    return SceneTree(tuple(node for node in nodes if node is not None), _extensions(document))


def _extensions(entry: Mapping[str, Any]) -> Mapping[str, Any]:
    found = entry.get("extensions")
    return found if isinstance(found, Mapping) else {}


def local_matrix(entry: Mapping[str, Any]) -> NDArray[np.float64]:
    """(4, 4) of a node: its ``matrix`` (column major) or translation * rotation (x, y, z, w) * scale."""
    if "matrix" in entry:
        return np.array(entry["matrix"], dtype=np.float64).reshape(4, 4).T
    x, y, z, w = np.array(entry.get("rotation", (0, 0, 0, 1)), dtype=np.float64)
    rotation = np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )
    out = np.eye(4)
    out[:3, :3] = rotation * np.array(entry.get("scale", (1, 1, 1)), dtype=np.float64)
    out[:3, 3] = entry.get("translation", (0, 0, 0))
    return out


def _json_chunk(data: bytes) -> dict[str, Any]:
    if len(data) < 20 or data[:4] != _MAGIC or data[16:20] != _JSON_CHUNK:
        raise MeshFileError("not a GLB file: no glTF header with a JSON chunk")
    length = struct.unpack_from("<I", data, 12)[0]
    if 20 + length > len(data):
        raise MeshFileError("the GLB file is cut short inside its JSON chunk")
    try:
        document = json.loads(data[20 : 20 + length])
    except ValueError as error:
        raise MeshFileError(f"the JSON chunk of the GLB file cannot be read: {error}") from error
    if not isinstance(document, dict):
        raise MeshFileError("the JSON chunk of the GLB file is no object")
    return document


def _unique_names(entries: list[Mapping[str, Any]]) -> list[str]:
    """Node names as trimesh gives them: the mesh's parts carry these."""
    seen: dict[str, int] = {}
    counts: dict[str | None, int] = {}
    for i, entry in enumerate(entries):
        name = entry.get("name", str(i))
        plain = isinstance(name, str) and name and name not in seen
        seen[name if plain else _another(name, seen, counts)] = i
    return list(seen)


def _another(name: str | None, seen: Mapping[str, int], counts: dict[str | None, int]) -> str:
    from trimesh.util import unique_name  # a large library, and few files name two nodes alike

    return str(unique_name(name, seen, counts=counts))


def _descendants(children: list[tuple[int, ...]], root: int) -> set[int]:
    found: set[int] = set()
    pending = [root]
    while pending:
        i = pending.pop()
        if i in found or not 0 <= i < len(children):
            raise MeshFileError("the nodes of the file form no tree")
        found.add(i)
        pending.extend(children[i])
    return found

"""What a GLB's JSON may not do: point outside the file, or build a node tree without an end."""

from __future__ import annotations

import json
import struct
from collections.abc import Mapping
from typing import Any

from gpu.gltf_draco import binary_chunk, check_draco
from gpu.gltf_tree import entries, is_index
from gpu.mesh_limits import MeshLimits, require

TRIANGLE_FAN = 6
UNSUPPORTED = ("EXT_meshopt_compression",)


def check_glb(data: bytes, limits: MeshLimits) -> str | None:
    """What is wrong with the container or its JSON, or None. Geometry is checked after reading.

    Raises ``MeshLimitError`` for counts past ``limits``.
    """
    if len(data) < 20 or data[:4] != b"glTF":
        return "the magic number is missing"
    version, length, json_length = struct.unpack_from("<III", data, 4)
    if version != 2:
        return f"version {version} is not 2"
    if length > len(data):
        return f"truncated: the header says {length} bytes, the file has {len(data)}"
    if data[16:20] != b"JSON" or 20 + json_length > len(data):
        return "the first chunk is no complete JSON chunk"
    require(limits, json_bytes=json_length)
    try:
        tree = json.loads(data[20 : 20 + json_length])
    except (ValueError, RecursionError) as error:
        return f"the JSON chunk cannot be read: {error}"
    if not isinstance(tree, dict):
        return "the JSON chunk is no object"
    problem = _foreign_data(tree) or _triangle_fans(tree) or _bad_nodes(tree, limits)
    return problem or _bad_counts(tree, limits) or check_draco(tree, binary_chunk(data, json_length))


def _foreign_data(tree: Mapping[str, Any]) -> str | None:
    for key in ("buffers", "images"):
        for i, entry in enumerate(entries(tree, key)):
            uri = entry.get("uri")
            if uri is not None and not str(uri).startswith("data:"):
                return f"{key}[{i}] refers to an external file; only embedded data is read"
    required = tree.get("extensionsRequired", [])
    for extension in UNSUPPORTED:
        if isinstance(required, list) and extension in required:
            return f"required extension {extension} is not supported; store the mesh uncompressed"
    return None


def _triangle_fans(tree: Mapping[str, Any]) -> str | None:
    """Fans are left out by the reader, which would change the silhouette without a word."""
    for i, mesh in enumerate(entries(tree, "meshes")):
        if any(primitive.get("mode") == TRIANGLE_FAN for primitive in entries(mesh, "primitives")):
            return f"mesh {i} has a triangle fan; only triangles and strips are read"
    return None


def _bad_nodes(tree: Mapping[str, Any], limits: MeshLimits) -> str | None:
    """Every node must be reached once (a forest, as glTF demands) and within ``limits.depth`` levels."""
    nodes = entries(tree, "nodes")
    require(limits, nodes=len(nodes))
    children: list[list[int]] = []
    parents = [0] * len(nodes)
    for i, node in enumerate(nodes):
        below = node.get("children", [])
        if not isinstance(below, list) or not all(isinstance(c, int) and 0 <= c < len(nodes) for c in below):
            return f"node {i} names a child that does not exist"
        children.append(below)
        for child in below:
            parents[child] += 1
    if any(count > 1 for count in parents):
        return f"node {next(i for i, c in enumerate(parents) if c > 1)} has more than one parent"
    level = [i for i, count in enumerate(parents) if count == 0]
    reached, depth = 0, 0
    while level:
        depth += 1
        if depth > limits.depth:
            return f"nodes are nested deeper than {limits.depth} levels"
        reached += len(level)
        level = [child for i in level for child in children[i]]
    return None if reached == len(nodes) else "the node tree contains a cycle"


def _bad_counts(tree: Mapping[str, Any], limits: MeshLimits) -> str | None:
    """Vertices and faces as the accessors state them, each mesh as often as nodes show it."""
    counts: list[int] = []
    for i, accessor in enumerate(entries(tree, "accessors")):
        count = accessor.get("count")
        if not isinstance(count, int) or count < 0:
            return f"accessor {i} states no count"
        if count > limits.vertices:  # an index three times for each face
            require(limits, faces=count // 3)
        counts.append(count)
    sizes = []
    for i, mesh in enumerate(entries(tree, "meshes")):
        vertices = indices = 0
        for primitive in entries(mesh, "primitives"):
            attributes = primitive.get("attributes")
            position = attributes.get("POSITION") if isinstance(attributes, dict) else None
            index = primitive.get("indices", position)
            if not (is_index(position, counts) and is_index(index, counts)):
                return f"mesh {i} refers to an accessor that does not exist"
            vertices, indices = vertices + counts[position], indices + counts[index]
        sizes.append((vertices, indices))
    shown = [node["mesh"] for node in entries(tree, "nodes") if is_index(node.get("mesh"), sizes)]
    require(
        limits, parts=len(shown), vertices=sum(sizes[k][0] for k in shown), faces=sum(sizes[k][1] for k in shown) // 3
    )
    return None

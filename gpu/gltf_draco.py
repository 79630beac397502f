"""Meshes that a GLB holds compressed (KHR_draco_mesh_compression): does each give what the file states?

trimesh decodes them with DracoPy, but goes on with zeros where that fails; so each is decoded here before.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator, Mapping
from typing import Any

import DracoPy

from gpu.gltf_tree import entries, is_index

NAME = "KHR_draco_mesh_compression"
TRIANGLES = 4


def check_draco(tree: Mapping[str, Any], binary: bytes) -> str | None:
    """What is wrong with the compressed meshes of a GLB's JSON and its binary chunk, or None.

    Counts of accessors and their numbers in primitives have been checked.
    """
    for number, primitive, extension in _compressed(tree):
        packed = _packed(tree, extension, binary)
        if packed is None:
            return f"mesh {number}: its Draco data are not in the binary chunk"
        problem = _differs(tree, primitive, extension, packed)
        if problem:
            return f"mesh {number}: its Draco data {problem}"
    return None


def binary_chunk(data: bytes, json_length: int) -> bytes:
    """The second chunk of a GLB, nothing where there is none."""
    start = 20 + json_length
    if len(data) < start + 8 or data[start + 4 : start + 8] != b"BIN\0":
        return b""
    return data[start + 8 : start + 8 + int(struct.unpack_from("<I", data, start)[0])]


def _compressed(tree: Mapping[str, Any]) -> Iterator[tuple[int, Mapping[str, Any], Mapping[str, Any]]]:
    for number, mesh in enumerate(entries(tree, "meshes")):
        for primitive in entries(mesh, "primitives"):
            extensions = primitive.get("extensions")
            if isinstance(extensions, dict) and isinstance(extensions.get(NAME), dict):
                yield number, primitive, extensions[NAME]


def _packed(tree: Mapping[str, Any], extension: Mapping[str, Any], binary: bytes) -> bytes | None:
    views, index = entries(tree, "bufferViews"), extension.get("bufferView")
    if not is_index(index, views):
        return None
    view = views[index]
    start, length = view.get("byteOffset", 0), view.get("byteLength")
    if view.get("buffer") != 0 or not isinstance(start, int) or not isinstance(length, int):
        return None
    return binary[start : start + length] if 0 <= start <= start + length <= len(binary) else None


def _differs(
    tree: Mapping[str, Any], primitive: Mapping[str, Any], extension: Mapping[str, Any], packed: bytes
) -> str | None:
    if primitive.get("mode", TRIANGLES) != TRIANGLES:
        return "are no triangles"
    try:
        mesh = DracoPy.decode(packed)
    except MemoryError:
        raise
    except Exception as error:  # noqa: BLE001 -- whatever the decoder trips over, the file is at fault
        return f"cannot be decoded: {error}"
    faces = getattr(mesh, "faces", None)
    if faces is None:
        return "hold no faces"
    numbers = extension.get("attributes")
    wanted = numbers.get("POSITION") if isinstance(numbers, dict) else None
    positions = [one["data"] for one in mesh.attributes if one["unique_id"] == wanted]
    if not positions:
        return "hold no positions"
    found = len(positions[0]), 3 * len(faces)
    accessors, position = entries(tree, "accessors"), primitive["attributes"]["POSITION"]
    stated = tuple(accessors[index]["count"] for index in (position, primitive.get("indices", position)))
    if found != stated or "indices" not in primitive:
        return f"hold {found[0]} vertices and {found[1]} indices; the file states {stated[0]} and {stated[1]}"
    return None

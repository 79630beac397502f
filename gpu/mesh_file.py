"""Bytes of a mesh file -> triangles per node, in file coordinates. Everything a file can lie about is checked here."""

from __future__ import annotations

import io
import re
from collections.abc import Sequence
from typing import Any

import numpy as np
import trimesh
from numpy.typing import NDArray

from gpu.collada_file import read_collada
from gpu.gltf_check import check_glb
from gpu.mesh_limits import MeshError, MeshLimits, require
from gpu.raw_part import RawPart
from gpu.urdf import read_urdf
from gpu.urdf_archive import unpack_urdf
from gpu.urdf_shapes import link_triangles

FILE_TYPES = ("glb", "obj", "stl", "ply", "urdf")
LARGEST_COORDINATE = 1e12
LONGEST_NAME = 255  # characters of a part's name: answers and warnings repeat it
DEFAULT_LIMITS = MeshLimits()
_PLY_ELEMENTS = re.compile(rb"^\s*element\s+(vertex|face)\s+(\d{1,18})\s*$", re.M)
_OBJECT = re.compile(rb"^o[ \t]+(.*?)[ \t\r]*$", re.M)
_PLY_HEADER_BYTES = 1 << 16


def read_parts(data: bytes, file_type: str, limits: MeshLimits = DEFAULT_LIMITS) -> list[RawPart]:
    """One part per node that carries triangles, in file order.

    Raises ``MeshError``, naming what is wrong, or ``MeshLimitError`` for what is past ``limits``: as far as the file
    states its sizes, before it is parsed.
    """
    kind = file_type.lower().lstrip(".")
    if kind not in FILE_TYPES:
        raise MeshError(f"file type {file_type!r} is not one of {', '.join(FILE_TYPES)}")
    if not data:
        raise MeshError("the file is empty")
    if kind == "urdf":
        return _urdf_parts(data, limits)
    if kind == "glb":
        problem = check_glb(data, limits)
        if problem:
            raise MeshError(f"GLB: {problem}")
    elif kind == "stl":
        _check_stl(data, limits)
    elif kind == "ply":
        found = {name: int(count) for name, count in _PLY_ELEMENTS.findall(data[:_PLY_HEADER_BYTES])}
        require(limits, vertices=found.get(b"vertex", 0), faces=found.get(b"face", 0))
    else:
        require(limits, vertices=data.count(b"\nv "), faces=data.count(b"\nf "), nodes=data.count(b"\no "))
    pieces = _nodes(_scene(data, kind))
    if kind == "obj":
        order = {name.decode(errors="replace"): -k for k, name in enumerate(reversed(_OBJECT.findall(data)))}
        pieces.sort(key=lambda piece: order.get(piece[0], 0))
    require(
        limits,
        parts=len(pieces),
        vertices=sum(len(vertices) for _, vertices, _ in pieces),
        faces=sum(len(faces) for _, _, faces in pieces),
    )
    parts = [_checked(name, vertices, faces) for name, vertices, faces in pieces]
    if not any(len(part.faces) for part in parts):
        raise MeshError("the file has no faces")
    return parts


def _urdf_parts(data: bytes, limits: MeshLimits) -> list[RawPart]:
    """One part per link with a shape; its mesh files are read, and limited, like any other."""
    document, meshes = unpack_urdf(data)

    def read_mesh(body: bytes, suffix: str) -> list[tuple[NDArray[np.float64], NDArray[np.int64]]]:
        if suffix.lower() == ".dae":
            return read_collada(body, limits)
        if suffix.lower() not in (".obj", ".stl", ".ply", ".glb"):
            raise MeshError(f"URDF: mesh files of type {suffix or 'none'} are not read; DAE, OBJ, STL, PLY and GLB are")
        return [(part.vertices, part.faces) for part in read_parts(body, suffix, limits)]

    links = link_triangles(read_urdf(document, limits), meshes, read_mesh, limits)
    parts = [_checked(name, *_joined(pieces)) for name, pieces in links]
    require(
        limits, parts=len(parts), vertices=sum(len(p.vertices) for p in parts), faces=sum(len(p.faces) for p in parts)
    )
    if not any(len(part.faces) for part in parts):
        raise MeshError("the file has no faces")
    return parts


def _scene(data: bytes, kind: str) -> trimesh.Scene:
    options: dict[str, Any] = {"process": False}
    if kind == "glb":
        options["skip_materials"] = True
    elif kind == "obj":
        options |= {"split_objects": True, "group_material": False, "skip_materials": True}
    try:
        return trimesh.load_scene(io.BytesIO(data), file_type=kind, **options)
    except MemoryError:
        raise
    except Exception as error:  # whatever the parser trips over, the file is at fault
        raise MeshError(f"cannot be read as {kind.upper()}: {type(error).__name__}: {error}") from error


def _nodes(scene: trimesh.Scene) -> list[tuple[str, NDArray[np.float64], NDArray[np.int64]]]:
    """Name, vertices and faces per node; the primitives of a glTF node, which trimesh makes nodes of, together."""
    found: dict[str, list[tuple[NDArray[np.float64], NDArray[np.int64]]]] = {}
    for node in scene.graph.nodes_geometry:
        try:
            matrix, geometry_name = scene.graph[node]
        except ValueError as error:
            raise MeshError(f"node {node!r}: {error}") from error
        geometry = scene.geometry[geometry_name]
        if not isinstance(geometry, trimesh.Trimesh):
            continue  # points and lines have no silhouette
        vertices = np.asarray(geometry.vertices, dtype=np.float64)
        if vertices.ndim != 2 or vertices.shape[1] != 3:
            raise MeshError(f"node {node!r}: its vertices do not have three coordinates")
        with np.errstate(all="ignore"):  # what is not finite is refused below, by name
            moved = vertices @ matrix[:3, :3].T + matrix[:3, 3]
        faces = np.asarray(geometry.faces, dtype=np.int64).reshape(-1, 3)
        found.setdefault(_owner(scene, node), []).append((moved, faces))
    return [(name, *_joined(pieces)) for name, pieces in found.items()]


def _owner(scene: trimesh.Scene, node: str) -> str:
    """The glTF node that a graph node belongs to: trimesh names a primitive's node after it, and six random letters."""
    parent = scene.graph.transforms.parents.get(node)
    is_primitive = parent not in scene.graph.nodes_geometry and re.fullmatch(rf"{re.escape(str(parent))}_\w{{6}}", node)
    return str(parent) if is_primitive else str(node)


def _joined(
    pieces: Sequence[tuple[NDArray[np.float64], NDArray[np.int64]]],
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    firsts = np.cumsum([0] + [len(vertices) for vertices, _ in pieces])
    faces = [faces + first for (_, faces), first in zip(pieces, firsts, strict=False)]
    return np.concatenate([vertices for vertices, _ in pieces]), np.concatenate(faces)


def _checked(name: str, vertices: NDArray[np.float64], faces: NDArray[np.int64]) -> RawPart:
    if len(name) > LONGEST_NAME:
        raise MeshError(f"part {name[:LONGEST_NAME]!r}...: its name is longer than {LONGEST_NAME} characters")
    if len(faces) and (faces.min() < 0 or faces.max() >= len(vertices)):
        raise MeshError(f"part {name!r}: a face names vertex {faces.max()} of {len(vertices)}")
    shown = np.zeros(len(vertices), dtype=bool)
    shown[faces] = True
    used = vertices[shown]
    if not np.isfinite(used).all():
        raise MeshError(f"part {name!r}: a vertex is NaN or infinite")
    if len(used) and np.abs(used).max() > LARGEST_COORDINATE:
        raise MeshError(f"part {name!r}: a coordinate exceeds {LARGEST_COORDINATE:g}")
    return RawPart(name, vertices, faces)


def _check_stl(data: bytes, limits: MeshLimits) -> None:
    """A binary STL's face count must agree with its length (84-byte header, 50 bytes a face)."""
    if data.lstrip()[:5].lower() == b"solid" and b"facet" in data[:2048].lower():
        require(limits, faces=data.lower().count(b"endfacet"))
        return
    if len(data) < 84:
        raise MeshError("STL: shorter than its 84-byte header")
    declared = int(np.frombuffer(data[80:84], dtype="<u4")[0])
    if len(data) != 84 + 50 * declared:
        raise MeshError(
            f"STL: the header declares {declared} faces ({84 + 50 * declared} bytes), the file has {len(data)} bytes"
        )
    require(limits, faces=declared)

"""What a URDF's links look like: boxes, cylinders, spheres, and mesh files that came with the document."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import PurePosixPath
from typing import Any
from xml.etree import ElementTree

import numpy as np
import trimesh
from numpy.typing import NDArray

from gpu.mesh_limits import MeshError, MeshLimits, require
from gpu.urdf import Matrix, UrdfRobot, name_of, numbers, origin_of

Triangles = tuple[Matrix, NDArray[np.int64]]
ReadMesh = Callable[[bytes, str], list[Triangles]]


def link_triangles(
    robot: UrdfRobot, meshes: Mapping[str, bytes], read_mesh: ReadMesh, limits: MeshLimits
) -> list[tuple[str, Sequence[Triangles]]]:
    """Shapes of every link in file coordinates: what is seen, or what collides where nothing of a robot is seen.

    Raises ``MeshError``, ``MeshLimitError``.
    """
    require(limits, nodes=sum(1 for _ in robot.root.iter("geometry")))
    kind = "visual" if robot.root.find("link/visual") is not None else "collision"
    found: list[tuple[str, Sequence[Triangles]]] = []
    faces_so_far = 0
    for link in robot.root.findall("link"):
        place = robot.links[name_of(link, "link")]
        pieces = [
            (_moved(place @ origin_of(shape), vertices), faces)
            for shape in link.findall(kind)
            for vertices, faces in _shape(shape, meshes, read_mesh)
        ]
        faces_so_far += sum(len(faces) for _, faces in pieces)
        require(limits, faces=faces_so_far)  # not at the end: one file may stand in a thousand places
        if pieces:
            found.append((name_of(link, "link"), pieces))
    return found


def _shape(element: ElementTree.Element, meshes: Mapping[str, bytes], read_mesh: ReadMesh) -> list[Triangles]:
    geometry = element.find("geometry")
    shape = None if geometry is None else next(iter(geometry), None)
    if shape is None:
        raise MeshError("URDF: a shape has no geometry")
    if shape.tag == "mesh":
        return _mesh(shape, meshes, read_mesh)
    size: dict[str, Any]
    if shape.tag == "box":
        solid = trimesh.creation.box(numbers(shape, "size", (0.0, 0.0, 0.0)))
    elif shape.tag == "cylinder":
        size = {key: numbers(shape, key, (0.0,))[0] for key in ("radius", "length")}
        solid = trimesh.creation.cylinder(size["radius"], size["length"], sections=48)
    elif shape.tag == "sphere":
        solid = trimesh.creation.icosphere(3, numbers(shape, "radius", (0.0,))[0])
    else:
        raise MeshError(f"URDF: a shape <{shape.tag}> is not known")
    return [(np.asarray(solid.vertices, dtype=np.float64), np.asarray(solid.faces, dtype=np.int64))]


def _mesh(shape: ElementTree.Element, meshes: Mapping[str, bytes], read_mesh: ReadMesh) -> list[Triangles]:
    """A mesh file, found by the last part of its address: ``package://`` and folders are not ours to follow."""
    path = PurePosixPath(shape.get("filename", "").replace("\\", "/"))
    if path.name not in meshes:
        known = ", ".join(sorted(meshes)) or "none"
        raise MeshError(f"URDF: mesh file {path.name!r} was not uploaded (field meshes); these were: {known}")
    scale = np.array(numbers(shape, "scale", (1.0, 1.0, 1.0)))
    flip = float(np.prod(scale)) < 0  # a mirrored mesh is turned inside out
    pieces = read_mesh(meshes[path.name], path.suffix)
    return [(vertices * scale, faces[:, ::-1] if flip else faces) for vertices, faces in pieces]


def _moved(matrix: Matrix, vertices: Matrix) -> Matrix:
    return vertices @ matrix[:3, :3].T + matrix[:3, 3]

"""The triangles of a COLLADA file (``.dae``), the mesh format of most URDF robots.

Geometry only: materials, lights, cameras and animations are taken out before the file is read. The file's unit is
applied, its up axis is not: so do the tools that read robots (RViz, Gazebo), and so are robots written.
"""

from __future__ import annotations

import io
from collections.abc import Iterator
from typing import Any
from xml.etree import ElementTree

import collada
import numpy as np
from numpy.typing import NDArray

from gpu.mesh_limits import MeshError, MeshLimits, require
from gpu.xml_document import read_xml

_SPACE = "{http://www.collada.org/2005/11/COLLADASchema}"
_LIBRARIES = ("asset", "library_geometries", "library_nodes", "library_visual_scenes", "scene")
_KEPT = {f"{_SPACE}{name}" for name in _LIBRARIES}
_SKINNED = f"{_SPACE}instance_controller"
_BINDING = f"{_SPACE}bind_material"
Triangles = tuple[NDArray[np.float64], NDArray[np.int64]]


def read_collada(data: bytes, limits: MeshLimits) -> list[Triangles]:
    """Vertices (V, 3) and faces (F, 3) of every primitive, in metres, in its place in the scene.

    Raises ``MeshError``, or ``MeshLimitError`` for what is past ``limits``: an instance counts each time it stands.
    """
    root = read_xml(data, "COLLADA")
    if root.tag != f"{_SPACE}COLLADA":
        raise MeshError("COLLADA: the root element is not <COLLADA> of version 1.4")
    require(limits, nodes=sum(1 for _ in root.iter(f"{_SPACE}node")))
    try:
        document = collada.Collada(io.BytesIO(_geometry_only(root)))
        scene = document.scene
        if scene is None:
            raise MeshError("COLLADA: there is no scene")
        unit = float(document.assetInfo.unitmeter or 1.0)
        found = list(_limited(_primitives(scene.nodes, unit * np.eye(4)[:3], 0, Visits(limits)), limits))
    except (MeshError, MemoryError):
        raise
    except Exception as error:  # whatever the parser trips over, the file is at fault
        raise MeshError(f"COLLADA: cannot be read: {type(error).__name__}: {error}") from error
    return found


def _geometry_only(root: ElementTree.Element) -> bytes:
    if next(root.iter(_SKINNED), None) is not None:
        raise MeshError("COLLADA: skinned meshes are not read; export the mesh as it stands at rest")
    for element in [child for child in root if child.tag not in _KEPT]:
        root.remove(element)
    for parent in list(root.iter()):
        for element in [child for child in parent if child.tag == _BINDING]:
            parent.remove(element)
    return ElementTree.tostring(root)


class Visits:
    """Counts nodes as often as they stand in the scene: a few that instance each other can stand there without end."""

    def __init__(self, limits: MeshLimits) -> None:
        self._limits, self._count = limits, 0

    def note(self, depth: int) -> None:
        """Raises ``MeshLimitError`` past the limits of nodes or of their depth."""
        self._count += 1
        require(self._limits, nodes=self._count, depth=depth)


def _primitives(nodes: Any, place: NDArray[np.float64], depth: int, visits: Visits) -> Iterator[Triangles]:
    """``place``: (3, 4), of the parent."""
    for node in nodes:
        visits.note(depth)
        if isinstance(node, collada.scene.GeometryNode):
            for primitive in node.geometry.primitives:
                yield from _triangles(primitive, place)
        elif isinstance(node, collada.scene.Node):  # an instance of a node is one too
            matrix = np.asarray(node.matrix, dtype=np.float64)
            moved = np.hstack([place[:, :3] @ matrix[:3, :3], place[:, :3] @ matrix[:3, 3:] + place[:, 3:]])
            yield from _primitives(node.children, moved, depth + 1, visits)


def _triangles(primitive: Any, place: NDArray[np.float64]) -> Iterator[Triangles]:
    if isinstance(primitive, collada.polylist.Polylist):
        primitive = primitive.triangleset()
    if not isinstance(primitive, collada.triangleset.TriangleSet) or primitive.vertex is None:
        return  # lines have no silhouette
    vertices = np.asarray(primitive.vertex, dtype=np.float64)
    faces = np.asarray(primitive.vertex_index, dtype=np.int64).reshape(-1, 3)
    if len(faces) and (faces.min() < 0 or faces.max() >= len(vertices)):
        raise MeshError(f"COLLADA: a face names vertex {faces.max()} of {len(vertices)}")
    used, faces = np.unique(faces, return_inverse=True)  # primitives share one list of vertices
    faces = faces.reshape(-1, 3)
    with np.errstate(all="ignore"):  # what is not finite is refused by name, with the part that it is in
        moved = vertices[used] @ place[:, :3].T + place[:, 3]
    yield moved, faces[:, ::-1] if np.linalg.det(place[:, :3]) < 0 else faces


def _limited(found: Iterator[Triangles], limits: MeshLimits) -> Iterator[Triangles]:
    vertices = faces = 0
    for piece in found:
        vertices, faces = vertices + len(piece[0]), faces + len(piece[1])
        require(limits, vertices=vertices, faces=faces)
        yield piece

"""Meshes: from a file's bytes to parts in the body frame, checked, repaired and, where it is safe, decimated."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from gpu.mesh_limits import MeshError
from gpu.raw_part import RawPart
from gpu.repair import describe_repair, is_watertight, repair

__all__ = ["Mesh", "MeshError", "Part", "assemble", "load_mesh"]


@dataclass(frozen=True)
class Part:
    """A rigid piece of the body: one node of the file."""

    name: str
    vertices: NDArray[np.float64]  # (V, 3) body frame, joints at rest
    faces: NDArray[np.int32]  # (F, 3)


@dataclass(frozen=True)
class Mesh:
    """A prepared mesh."""

    parts: tuple[Part, ...]
    centre: tuple[float, float, float]  # of the bounding box at rest, file coordinates
    size: tuple[float, float, float]  # of that box, model units
    radius: float  # largest distance of a vertex from the centre
    watertight: bool
    warnings: tuple[str, ...] = ()

    @property
    def n_faces(self) -> int:
        """Faces over all parts."""
        return sum(len(part.faces) for part in self.parts)

    @property
    def n_vertices(self) -> int:
        """Vertices over all parts."""
        return sum(len(part.vertices) for part in self.parts)

    @cached_property
    def faces(self) -> NDArray[np.int64]:
        """(F, 3) faces of all parts, their vertices counted one part after the other."""
        offsets = np.cumsum([0, *(len(part.vertices) for part in self.parts)])
        return np.vstack([part.faces + first for part, first in zip(self.parts, offsets[:-1], strict=True)])

    @cached_property
    def part_of(self) -> NDArray[np.int64]:
        """(F,) number of the part that a face belongs to."""
        return np.repeat(np.arange(len(self.parts)), [len(part.faces) for part in self.parts])

    @cached_property
    def normals(self) -> NDArray[np.float64]:
        """(F, 3) unit normals of the faces, joints at rest."""
        p, q, r = np.moveaxis(np.vstack([part.vertices for part in self.parts])[self.faces], 1, 0)
        normal = np.cross(q - p, r - p)
        return np.asarray(normal / np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-300), np.float64)

    @cached_property
    def pieces(self) -> NDArray[np.int64]:
        """(F,) which of the body's pieces a face belongs to: those of one piece are joined by their vertices."""
        from scipy.sparse import coo_array
        from scipy.sparse.csgraph import connected_components

        faces, size = self.faces, self.n_vertices
        a, b = np.concatenate([faces[:, 0], faces[:, 1]]), np.concatenate([faces[:, 1], faces[:, 2]])
        links = coo_array((np.ones(len(a), np.int8), (a, b)), shape=(size, size))
        return np.asarray(connected_components(links, directed=False)[1][faces[:, 0]], np.int64)

    @cached_property
    def surfaces(self) -> NDArray[np.int64]:
        """(F,) which surface a face belongs to: of one piece, and facing about the same way."""
        way = np.mgrid[-1:2, -1:2, -1:2].reshape(3, -1).T.astype(np.float64)
        way = way[np.any(way != 0, axis=1)]
        facing = np.argmax(self.normals @ (way / np.linalg.norm(way, axis=1, keepdims=True)).T, axis=1)
        return np.asarray(np.unique(self.pieces * len(way) + facing, return_inverse=True)[1], np.int64)

    def placed(self, transforms: NDArray[np.float64]) -> NDArray[np.float64]:
        """(V, 3) vertices of all parts, each part moved by its own of ``transforms`` (P, 3, 4)."""
        return np.vstack([p.vertices @ m[:, :3].T + m[:, 3] for p, m in zip(self.parts, transforms, strict=True)])


def load_mesh(data: bytes, file_type: str) -> Mesh:
    """Read, check and repair a mesh file (``glb``, ``obj``, ``stl`` or ``ply``).

    One part per geometry node, in file order, vertices relative to the centre of the bounding box at rest.
    What was repaired is said in ``warnings``. Raises ``MeshError`` for a file that is no usable mesh.
    """
    from gpu.mesh_file import read_parts  # large libraries, which workers leave to their decode process

    return assemble(read_parts(data, file_type))


def assemble(raw: Sequence[RawPart]) -> Mesh:
    """Repair parts given in file coordinates and centre them. Raises ``MeshError`` if no face is left."""
    repaired = [(part.name, *repair(part.vertices, part.faces)) for part in raw]
    kept = [(name, vertices, faces) for name, vertices, faces, _ in repaired if len(faces)]
    if not kept:
        raise MeshError("the mesh has no face with an area")
    low = np.min([vertices.min(axis=0) for _, vertices, _ in kept], axis=0)
    high = np.max([vertices.max(axis=0) for _, vertices, _ in kept], axis=0)
    centre = 0.5 * (low + high)
    parts = tuple(Part(name, vertices - centre, faces) for name, vertices, faces in kept)
    radius = max(float(np.linalg.norm(part.vertices, axis=1).max()) for part in parts)
    return Mesh(
        parts=parts,
        centre=_triple(centre),
        size=_triple(high - low),
        radius=radius,
        watertight=all(is_watertight(part.faces) for part in parts),
        warnings=tuple(w for name, _, _, counts in repaired for w in describe_repair(name, counts)),
    )


def _triple(values: NDArray[np.float64]) -> tuple[float, float, float]:
    x, y, z = (float(v) for v in values)
    return x, y, z

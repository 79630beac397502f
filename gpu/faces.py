"""A mesh as arrays of vertices and faces, for the scorers that fill faces."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gpu.components import components
from gpu.mesh import Mesh, Part
from gpu.repair import is_watertight


@dataclass(frozen=True)
class FaceTable:
    """Parts after each other. A face's fourth number says whether its piece is closed: back faces can be left out."""

    vertices: NDArray[np.float32]  # (V, 3)
    vertex_starts: NDArray[np.int32]  # (P + 1,)
    faces: NDArray[np.int32]  # (F, 4) vertices counted from the part's first
    face_starts: NDArray[np.int32]  # (P + 1,)

    @property
    def most_vertices(self) -> int:
        """Vertices of the largest part."""
        return int(np.diff(self.vertex_starts).max())

    @property
    def most_faces(self) -> int:
        """Faces of the part that has most."""
        return int(np.diff(self.face_starts).max()) + 1


def face_table(mesh: Mesh) -> FaceTable:
    """All parts of a mesh."""
    faces = [marked_faces(part) for part in mesh.parts]
    return FaceTable(
        np.concatenate([part.vertices for part in mesh.parts]).astype(np.float32),
        np.cumsum([0] + [len(part.vertices) for part in mesh.parts]).astype(np.int32),
        np.concatenate(faces),
        np.cumsum([0] + [len(f) for f in faces]).astype(np.int32),
    )


def marked_faces(part: Part) -> NDArray[np.int32]:
    """(F, 4) faces of a part, and whether the piece that each belongs to is closed."""
    pieces = [piece.faces for piece in components(part.vertices, part.faces)]
    return np.concatenate([np.insert(faces, 3, int(is_watertight(faces)), axis=1) for faces in pieces]).astype(np.int32)

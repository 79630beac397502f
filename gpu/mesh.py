"""Meshes: from a file's bytes to parts in the body frame, checked, repaired and, where it is safe, decimated."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


class MeshError(ValueError):
    """The file is no usable mesh; the message says why."""


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

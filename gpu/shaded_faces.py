"""Faces as ``kernels/shaded.cl`` takes them: corners side by side, those of a part together, padded to sixteens."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gpu.mesh import Mesh
from gpu.surface_groups import merged_pieces

LANES = 16
Numbers = NDArray[np.float32]
Indices = NDArray[np.int32]


@dataclass(frozen=True)
class FaceTable:
    """One body's faces; F of them, padded to K, a multiple of ``LANES`` for every part."""

    corners: Numbers  # (3, 3, K): corner, axis, face; body frame at rest
    starts: Indices  # (P + 1,) where a part's faces begin, in units of LANES faces
    groups: Indices  # (K,)
    shut: Numbers  # (K,) of a closed piece 1 or -1, as its faces turn; 0: both sides of the face are seen
    boxes: Numbers  # (P, 7) centre, half extents and radius of each part at rest
    origin: NDArray[np.int64]  # (K,) the face's number in the mesh; -1: padding

    @property
    def n_padded(self) -> int:
        """K."""
        return len(self.groups)

    @property
    def bits(self) -> int:
        """Bits of a face's number."""
        return max((self.n_padded - 1).bit_length(), 1)


def face_table(mesh: Mesh, groups: NDArray[np.integer], kept: NDArray[np.bool_] | None = None) -> FaceTable:
    """Arrange the mesh's faces, or those of them that are ``kept`` (F,); ``groups`` (F,) are their surface groups."""
    vertices = np.vstack([part.vertices for part in mesh.parts])
    kept = np.ones(mesh.n_faces, dtype=bool) if kept is None else kept
    parts = [np.flatnonzero((mesh.part_of == p) & kept) for p in range(len(mesh.parts))]
    padded = [np.append(own, np.full(-len(own) % LANES, -1)) for own in parts]
    origin = np.concatenate(padded).astype(np.int64)
    real = origin >= 0
    corners = np.zeros((len(origin), 3, 3))
    corners[real] = vertices[mesh.faces[origin[real]]]
    own, turned = np.zeros(len(origin)), closed_sides(mesh)
    own[real] = turned[origin[real]]
    return FaceTable(
        corners=np.ascontiguousarray(corners.transpose(1, 2, 0), np.float32),
        starts=np.cumsum([0, *(len(one) // LANES for one in padded)]).astype(np.int32),
        groups=np.where(real, groups[np.maximum(origin, 0)], 0).astype(np.int32),
        shut=own.astype(np.float32),
        boxes=np.stack([part_box(part.vertices) for part in mesh.parts]).astype(np.float32),
        origin=origin,
    )


def closed_sides(mesh: Mesh) -> NDArray[np.float64]:
    """(F,) 1 or -1 for faces of closed pieces whose normals point out of them, or into them; 0 for the others.

    A piece is closed if as many faces run along every edge one way as the other. Of such a piece a camera outside
    never sees a back side.
    """
    vertices = np.vstack([part.vertices for part in mesh.parts])
    merged, pieces = merged_pieces(mesh)
    faces = merged[mesh.faces]
    a, b = faces.ravel(), np.roll(faces, -1, axis=1).ravel()
    low, high = np.minimum(a, b), np.maximum(a, b)
    _, edge = np.unique(low * (int(faces.max()) + 1) + high, return_inverse=True)
    balance = np.bincount(edge, weights=np.sign(b - a).astype(np.float64))
    unbalanced = balance[edge] != 0
    owner = np.repeat(pieces, 3)
    is_open = np.bincount(owner, weights=unbalanced) > 0
    p, q, r = np.moveaxis(vertices[mesh.faces], 1, 0)
    volume = np.bincount(pieces, weights=np.einsum("ij,ij->i", p, np.cross(q, r)))
    return np.where(is_open, 0.0, np.sign(volume))[pieces]


def part_box(vertices: NDArray[np.float64]) -> NDArray[np.float64]:
    """(7,) centre, half extents and radius of (V, 3) points."""
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    centre = 0.5 * (low + high)
    radius = float(np.linalg.norm(vertices - centre, axis=1).max())
    return np.array([*centre, *(0.5 * (high - low)), radius])

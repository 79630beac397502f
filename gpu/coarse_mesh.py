"""A body with no more faces than a picture of some size can show; its silhouette and its groups stay.

Each group of each part is simplified by itself: first by collapsing edges as long as no face moves by more than a
fraction of a pixel (quadric error), then by joining vertices that lie within one cell of a grid of that size, which
turns thin boxes to sheets and takes away what is smaller than a sample. A part whose silhouette suffers is left finer.
"""

from __future__ import annotations

from collections.abc import Callable

import fast_simplification
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from gpu.mesh import Mesh, Part
from gpu.silhouettes import silhouettes
from gpu.surface_groups import merged_pieces

Floats = NDArray[np.float64]
Indices = NDArray[np.int64]
Piece = tuple[Floats, Indices]  # vertices (V, 3), faces (F, 3)

ERROR_PX = 0.14  # by which a face may move, and the size of a cell
LARGEST_CHANGE = 0.03  # of a part's area in pictures: what a coarse one may cover too much or too little
LEAST_CHANGE = 0.002  # of the whole body's: what does not count, however small the part
VIEWS = 16
_SAMPLES = 2  # for each pixel, along one axis, where silhouettes are compared
_FEWEST = 64  # faces of a part from which on it is worth the work
_THRESHOLD = float(np.finfo(np.float64).eps)  # of the square error, in the library's units, in its lossless mode


def coarse_mesh(
    mesh: Mesh, groups: NDArray[np.integer], radius_px: float, *, error_px: float = ERROR_PX
) -> tuple[Mesh, NDArray[np.int32]]:
    """The mesh for pictures in which its radius is ``radius_px``, and the groups (F',) of its faces.

    ``groups`` (F,) are those of the mesh's faces. Parts keep their order, names and places; no group is lost.
    """
    pixel = mesh.radius / radius_px
    place, _ = merged_pieces(mesh)
    vertices = np.empty((int(place.max()) + 1, 3))
    vertices[place] = np.vstack([part.vertices for part in mesh.parts])
    faces = place[mesh.faces]
    wholes = [_compact(vertices, faces[mesh.part_of == number]) for number in range(len(mesh.parts))]
    shown = [_Views(whole, pixel) for whole in wholes]
    least = LEAST_CHANGE * sum(views.area for views in shown)
    parts, kept = [], []
    for number, (part, whole, views) in enumerate(zip(mesh.parts, wholes, shown, strict=True)):
        own = groups[mesh.part_of == number]
        found = _coarse_part(whole, own, views, least, error_px * pixel) if len(own) >= _FEWEST else None
        simpler, group = found if found is not None else ((part.vertices, part.faces.astype(np.int64)), own)
        parts.append(Part(part.name, simpler[0], simpler[1].astype(np.int32)))
        kept.append(group)
    coarse = Mesh(tuple(parts), mesh.centre, mesh.size, mesh.radius, mesh.watertight, mesh.warnings)
    return coarse, np.concatenate(kept).astype(np.int32)


class _Views:
    """A part's silhouettes from ``VIEWS`` sides, and what others of it change in them."""

    def __init__(self, whole: Piece, pixel: float) -> None:
        self._middle = 0.5 * (whole[0].min(axis=0) + whole[0].max(axis=0))
        radius = float(np.linalg.norm(whole[0] - self._middle, axis=1).max())
        self._side = int(np.ceil(2.0 * _SAMPLES * radius / pixel)) + 2
        turns = Rotation.random(VIEWS, random_state=np.random.default_rng(0)).as_matrix()
        self._turns = turns.transpose(0, 2, 1) * (_SAMPLES / pixel)
        self._wanted = self._seen(whole)
        self.area = int(np.count_nonzero(self._wanted))

    def _seen(self, piece: Piece) -> NDArray[np.bool_]:
        return silhouettes((piece[0] - self._middle) @ self._turns + 0.5 * self._side, piece[1], self._side)

    def changed(self, piece: Piece) -> int:
        """In how many samples another silhouette differs."""
        return int(np.count_nonzero(self._seen(piece) != self._wanted))


def _coarse_part(
    whole: Piece, groups: NDArray[np.integer], views: _Views, least: float, size: float
) -> tuple[Piece, NDArray[np.integer]] | None:
    """The coarser of two that keeps the part's silhouette, and its faces' groups; None where neither does."""
    flat = _in_groups(*whole, groups, lambda piece: _collapsed(piece, size))
    joined = _in_groups(*flat[0], flat[1], lambda piece: _clustered(piece, size))
    for piece, group in (joined, flat):
        if views.changed(piece) <= max(LARGEST_CHANGE * views.area, least):
            return piece, group
    return None


def _in_groups(
    vertices: Floats, faces: Indices, groups: NDArray[np.integer], change: Callable[[Piece], Piece]
) -> tuple[Piece, NDArray[np.integer]]:
    """Each group's faces changed by themselves; those of a group of which nothing would be left stay."""
    points, corners, numbers, count = [], [], [], 0
    for group in np.unique(groups):
        before = _compact(vertices, faces[groups == group])
        after = change(before)
        own_vertices, own_faces = after if len(after[1]) else before
        points.append(own_vertices)
        corners.append(own_faces + count)
        numbers.append(np.full(len(own_faces), group))
        count += len(own_vertices)
    return (np.vstack(points), np.vstack(corners)), np.concatenate(numbers)


def _collapsed(piece: Piece, error: float) -> Piece:
    """Edges collapsed while the sum of squared distances to the planes of all merged faces is below error^2."""
    zoom = _THRESHOLD**0.5 / error
    points, faces = fast_simplification.simplify(
        piece[0] * zoom, piece[1].astype(np.int32), lossless=True, preserve_border=True
    )
    if len(faces) == 0:
        return piece
    return np.asarray(points, np.float64) / zoom, np.asarray(faces, np.int64)


def _clustered(piece: Piece, cell: float) -> Piece:
    """Vertices in one cell of a grid become the one of them that is nearest to their mean; faces left double go."""
    vertices, faces = piece
    _, owner = np.unique(np.round(vertices / cell).astype(np.int64), axis=0, return_inverse=True)
    owner = owner.reshape(-1)
    count = np.bincount(owner)
    mean = np.stack([np.bincount(owner, vertices[:, k]) / count for k in range(3)], axis=1)
    order = np.lexsort((((vertices - mean[owner]) ** 2).sum(axis=1), owner))
    nearest = order[np.diff(owner[order], prepend=-1) != 0]
    faces = nearest[owner[faces]]
    proper = (faces[:, 0] != faces[:, 1]) & (faces[:, 1] != faces[:, 2]) & (faces[:, 2] != faces[:, 0])
    faces = faces[proper]
    _, first = np.unique(np.sort(faces, axis=1), axis=0, return_index=True)
    return _compact(vertices, faces[np.sort(first)])


def _compact(vertices: Floats, faces: Indices) -> Piece:
    """Only the vertices in use."""
    used, flat = np.unique(faces, return_inverse=True)
    return vertices[used], flat.reshape(-1, 3)

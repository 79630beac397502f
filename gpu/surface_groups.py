"""Which faces of a body are painted alike: connected pieces, the largest on their own."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from gpu.mesh import Mesh

FEWEST, MOST = 32, 64  # groups, where no number is asked for
ALONE = 0.97  # of the area that should have paint of its own: what shares one is told as discrepancy
_SHINES = 0.01  # numerical: of the area: a group of so much has gloss of its own
_SAME_POINT = 1e-5  # of the body's radius: vertices nearer than about this are one


def surface_groups(mesh: Mesh, most: int | None = None) -> NDArray[np.int32]:
    """(F,) number of the group that each face belongs to, at most ``most`` groups, the largest in area first.

    ``most`` None: as many, 32 to 64, as it takes for pieces with a group of their own to have 0.97 of the area.

    A group is a connected piece of one part, all its sides: one paint. Where there are more pieces than groups, the
    small ones of a part go together, and where there are more parts than that allows, those of all parts.
    """
    if most is not None and most < 1:
        raise ValueError(f"at least one group is needed, not {most}")
    _, pieces = merged_pieces(mesh)
    area = face_areas(mesh)
    piece_area = np.bincount(pieces, weights=area).astype(np.float64)
    n_pieces = len(piece_area)
    piece_part = np.zeros(n_pieces, np.int64)
    piece_part[pieces] = mesh.part_of
    label = np.arange(n_pieces)
    if most is None:
        held = np.cumsum(np.sort(piece_area)[::-1])
        most = min(max(int(np.searchsorted(held, ALONE * held[-1])) + 1 + len(mesh.parts), FEWEST), MOST)
    if n_pieces > most:
        label = _joined(piece_area, piece_part, most)
    group = label[pieces]
    return _by_area(group, area)


def gloss_groups(mesh: Mesh, groups: NDArray[np.integer]) -> NDArray[np.int32]:
    """(G,) of each group that whose gloss is its own: the large ones have each their own, the rest have one together.

    ``groups`` (F,), the largest first. A lobe shows on few faces at a time, so what is small tells nothing of its own.
    """
    area = np.bincount(groups, weights=face_areas(mesh))
    large = int(np.count_nonzero(area >= _SHINES * area.sum()))
    return np.minimum(np.arange(len(area)), large).astype(np.int32)


def face_areas(mesh: Mesh) -> NDArray[np.float64]:
    """(F,) areas, model units squared."""
    p, q, r = np.moveaxis(np.vstack([part.vertices for part in mesh.parts])[mesh.faces], 1, 0)
    return np.asarray(0.5 * np.linalg.norm(np.cross(q - p, r - p), axis=1))


def merged_pieces(mesh: Mesh) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """(V,) a number for each place, the same for vertices of one part that lie together; (F,) each face's piece.

    Faces of one piece are connected by such places. No piece spans two parts.
    """
    vertices = np.vstack([part.vertices for part in mesh.parts])
    part = np.repeat(np.arange(len(mesh.parts)), [len(p.vertices) for p in mesh.parts])
    cell = np.round(vertices / (_SAME_POINT * max(mesh.radius, 1e-300))).astype(np.int64)
    place = _numbered(np.column_stack([part, cell]))
    faces = place[mesh.faces]
    size = int(place.max()) + 1
    a, b = np.concatenate([faces[:, 0], faces[:, 1]]), np.concatenate([faces[:, 1], faces[:, 2]])
    links = coo_array((np.ones(len(a), np.int8), (a, b)), shape=(size, size))
    piece = connected_components(links, directed=False)[1][faces[:, 0]]
    return place, np.unique(piece, return_inverse=True)[1].reshape(-1).astype(np.int64)


def _numbered(rows: NDArray[np.int64]) -> NDArray[np.int64]:
    """(N,) equal numbers for equal rows of (N, K)."""
    order = np.lexsort(rows.T[::-1])
    new = np.ones(len(rows), dtype=bool)
    new[1:] = np.any(np.diff(rows[order], axis=0) != 0, axis=1)
    number = np.empty(len(rows), np.int64)
    number[order] = np.cumsum(new) - 1
    return number


def _joined(area: NDArray[np.float64], part: NDArray[np.int64], most: int) -> NDArray[np.int64]:
    """(pieces,) labels: as many large pieces on their own as leave room for one rest per part."""
    order = np.argsort(-area, kind="stable")
    own = most
    while own > 0 and own + len(np.unique(part[order[own:]])) > most:
        own -= 1
    label = np.empty(len(area), np.int64)
    label[order[:own]] = np.arange(own)
    rest = order[own:]
    if own > 0 or len(np.unique(part[rest])) <= most:
        label[rest] = own + part[rest]
        return label
    return _joined(area, np.zeros_like(part), most)  # more parts than groups


def _by_area(label: NDArray[np.int64], area: NDArray[np.float64]) -> NDArray[np.int32]:
    """The same groups, numbered from the largest on."""
    names, compact = np.unique(label, return_inverse=True)
    total = np.bincount(compact, weights=area, minlength=len(names))
    rank = np.empty(len(names), np.int32)
    rank[np.argsort(-total, kind="stable")] = np.arange(len(names), dtype=np.int32)
    return np.asarray(rank[compact.reshape(-1)], np.int32)

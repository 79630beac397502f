"""Facets of a body's surface groups: what of a piece lies in about one plane, or bends smoothly."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from gpu.mesh import Mesh
from gpu.surface_groups import MOST, face_areas, merged_pieces

_BEND_DEG = 30.0  # numerical: across an edge that bends more, light changes at once; a tube of 12 sides is smooth
_LEAST = 0.01  # numerical: of the body's area: what is smaller goes with the largest facet of its group


def surface_facets(mesh: Mesh, groups: NDArray[np.int32]) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    """(F,) number of each face's facet, those of one group together; (K,) of each facet its group.

    ``groups`` (F,): ``surface_groups.surface_groups``. The largest facets have numbers of their own, as many as 64
    allow beside one for each group.
    """
    smooth, area, n = _smooth_faces(mesh), face_areas(mesh), int(groups.max()) + 1
    names, pair = np.unique(groups.astype(np.int64) * (smooth.max() + 1) + smooth, return_inverse=True)
    group, size = names // (smooth.max() + 1), np.bincount(pair.ravel(), weights=area)
    order = np.lexsort((-size, group))
    first = order[np.flatnonzero(np.diff(group[order], prepend=-1))]  # of each group the largest
    others = np.setdiff1d(np.argsort(-size, kind="stable"), first, assume_unique=True)
    others = others[np.argsort(-size[others], kind="stable")]
    others = others[size[others] >= _LEAST * area.sum()][: max(MOST - n, 0)]
    facet = first[group]
    facet[others] = others
    kept = order[np.isin(order, np.concatenate([first, others]))]
    rank = np.empty(len(names), np.int32)
    rank[kept] = np.arange(len(kept), dtype=np.int32)
    return rank[facet[pair.ravel()]], group[kept].astype(np.int32)


def _smooth_faces(mesh: Mesh) -> NDArray[np.int64]:
    """(F,) the same number for faces that are connected across edges which bend little."""
    place, _ = merged_pieces(mesh)
    faces = place[mesh.faces]
    edges = np.sort(np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]), axis=1)
    key, face = edges[:, 0] * (int(faces.max()) + 1) + edges[:, 1], np.tile(np.arange(len(faces)), 3)
    order = np.argsort(key, kind="stable")
    same = np.diff(key[order]) == 0
    one, other = face[order[:-1][same]], face[order[1:][same]]
    straight = np.abs(np.sum(mesh.normals[one] * mesh.normals[other], axis=1))  # they may be wound either way
    bends = straight <= np.cos(np.deg2rad(_BEND_DEG))
    one, other = one[~bends], other[~bends]
    links = coo_array((np.ones(len(one), np.int8), (one, other)), shape=(len(faces), len(faces)))
    return np.asarray(connected_components(links, directed=False)[1], np.int64)

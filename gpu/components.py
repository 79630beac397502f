"""Pieces of a part that share no edge, each with its outline edges and a box around it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from gpu.edges import Edges, outline_edges


@dataclass(frozen=True)
class Component:
    """Faces connected by edges. ``box`` is (4, 3): the centre, then three half axes, of a box around the piece."""

    faces: NDArray[np.int32]  # (F, 3) into the part's vertices
    edges: Edges
    box: NDArray[np.float64]


def components(vertices: NDArray[np.float64], faces: NDArray[np.int32]) -> list[Component]:
    """Split (V, 3), (F, 3) into connected pieces, largest box first."""
    labels = _face_labels(faces)
    order = np.argsort(labels, kind="stable")
    groups = np.split(faces[order], np.flatnonzero(np.diff(labels[order])) + 1)
    pieces = [Component(f, outline_edges(vertices, f), _box(vertices[np.unique(f)])) for f in groups]
    return sorted(pieces, key=lambda piece: -float((piece.box[1:] ** 2).sum()))


def _face_labels(faces: NDArray[np.int32]) -> NDArray[np.int32]:
    """(F,) number of the piece that each face belongs to."""
    edges = np.sort(np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]), axis=1)
    _, edge = np.unique(edges, axis=0, return_inverse=True)
    edge = edge.reshape(-1)
    face = np.tile(np.arange(len(faces)), 3)
    incidence = coo_array((np.ones(len(edge), np.int8), (face, len(faces) + edge)), shape=(len(faces) + len(edge),) * 2)
    return np.asarray(connected_components(incidence, directed=False)[1][: len(faces)], dtype=np.int32)


def _box(points: NDArray[np.float64]) -> NDArray[np.float64]:
    """(4, 3): centre and half axes of a box along the principal axes of the points."""
    axes = np.linalg.svd(points - points.mean(axis=0), full_matrices=True)[2]
    along = points @ axes.T
    low, high = along.min(axis=0), along.max(axis=0)
    return np.vstack([0.5 * (low + high) @ axes, 0.5 * (high - low)[:, None] * axes])

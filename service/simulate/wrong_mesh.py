"""A body that is not quite its mesh: real spacecraft differ from what is drawn of them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from gpu.mesh import Mesh
from service.simulate.materials import face_areas

_SMALL, _CHANCE_MISSING = 0.03, 0.25  # of the surface: pieces as small may be missing
_SHIFT = 0.2  # of the error: by how much of the radius a piece stands elsewhere


def misshapen(mesh: Mesh, rng: np.random.Generator, error: float) -> Mesh:
    """The mesh with each connected piece stretched, moved, or, if it is small, missing.

    ``error``: standard deviation of the log of each piece's size along each axis. A part keeps its largest piece.
    """
    if error <= 0:
        return mesh
    pieces, area = mesh.pieces, face_areas(mesh)
    count = int(pieces.max()) + 1
    missing = rng.random(count) < _CHANCE_MISSING
    stretch = np.exp(error * rng.standard_normal((count, 3)))
    shift = _SHIFT * error * mesh.radius * rng.standard_normal((count, 3))
    parts = []
    for number, part in enumerate(mesh.parts):
        own = mesh.part_of == number
        of_face, kept = pieces[own], np.ones(len(part.faces), bool)
        size = np.bincount(of_face, area[own], count) / area.sum()
        moved = part.vertices.copy()
        for piece in np.unique(of_face):
            at = np.unique(part.faces[of_face == piece])
            middle = part.vertices[at].mean(axis=0)
            moved[at] = middle + stretch[piece] * (part.vertices[at] - middle) + shift[piece]
            if missing[piece] and size[piece] < _SMALL and size[piece] < size.max():
                kept[of_face == piece] = False
        parts.append(replace(part, vertices=moved, faces=part.faces[kept]))
    return replace(mesh, parts=tuple(parts))

"""What the faces of a body are made of: one paint per piece, or the mixture that real spacecraft have."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from gpu.mesh import Mesh

Floats = NDArray[np.float64]
Materials = Literal["painted", "mixed"]

_GLASS = 0.04  # what glass, varnish and binder reflect
_CHANCES = (0.6, 0.17, 0.23)  # of paint, panel, metal
PIECES_OF_THEIR_OWN = 10  # of each part, the largest; the other pieces have one paint together


@dataclass(frozen=True)
class Surface:
    """Reflection per face, (F,) each; 1 is a white facet that faces the sun.

    Without a ``roughness`` the gloss is the light's own, alike on all faces.
    """

    diffuse: Floats
    mirror: Floats | None = None
    """Share of the light that comes back in the glossy lobe (Fresnel reflectance at its middle)."""
    roughness: Floats | None = None
    """Of the micro-facets that make the lobe."""


@dataclass(frozen=True)
class _Material:
    albedo: float
    mirror: float
    roughness: float


def painted(mesh: Mesh, rng: np.random.Generator) -> Surface:
    """One reflectance per connected piece, from 0.35 to 0.95, all equally glossy."""
    pieces = mesh.pieces
    return Surface(np.asarray(rng.uniform(0.35, 0.95, int(pieces.max()) + 1)[pieces]))


def mixed(mesh: Mesh, rng: np.random.Generator) -> Surface:
    """Paint, dark panels and rough metal on the ten largest pieces of each part, one paint on all others."""
    drawn = [_draw_paint(rng)]
    material = np.zeros(mesh.n_faces, dtype=np.int64)
    area = face_areas(mesh)
    for part in range(len(mesh.parts)):
        faces = np.flatnonzero(mesh.part_of == part)
        _, of_face = np.unique(mesh.pieces[faces], return_inverse=True)
        size = np.bincount(of_face, area[faces])
        for piece in np.argsort(-size, kind="stable")[:PIECES_OF_THEIR_OWN]:
            material[faces[of_face == piece]] = len(drawn)
            drawn.append(_draw_any(rng))
    columns = np.array([(m.albedo, m.mirror, m.roughness) for m in drawn])[material]
    return Surface(columns[:, 0], columns[:, 1], columns[:, 2])


SURFACES: Mapping[Materials, Callable[[Mesh, np.random.Generator], Surface]] = {"painted": painted, "mixed": mixed}


def _draw_any(rng: np.random.Generator) -> _Material:
    kind = rng.choice(3, p=_CHANCES)
    return (_draw_paint, _draw_panel, _draw_metal)[kind](rng)


def _draw_paint(rng: np.random.Generator) -> _Material:
    return _Material(rng.uniform(0.15, 0.8), _GLASS, rng.uniform(0.25, 0.6))


def _draw_panel(rng: np.random.Generator) -> _Material:
    """Solar cells under glass."""
    return _Material(rng.uniform(0.05, 0.14), _GLASS, rng.uniform(0.15, 0.3))


def _draw_metal(rng: np.random.Generator) -> _Material:
    """Bare or coated metal, foil: hardly any diffuse light, a strong lobe."""
    return _Material(rng.uniform(0.02, 0.08), rng.uniform(0.6, 0.9), rng.uniform(0.15, 0.45))


def face_areas(mesh: Mesh) -> Floats:
    """(F,) areas of the faces."""
    corners = np.vstack([part.vertices for part in mesh.parts])[mesh.faces]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    return np.asarray(0.5 * np.linalg.norm(normal, axis=1))

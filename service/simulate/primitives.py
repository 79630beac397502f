"""Closed solids that the demo satellite is built from. Every face is seen counter-clockwise from outside."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Vector = tuple[float, float, float]


@dataclass(frozen=True)
class Solid:
    """A closed triangle mesh."""

    vertices: NDArray[np.float64]  # (V, 3)
    faces: NDArray[np.int64]  # (F, 3)

    def moved(self, translation: Vector = (0, 0, 0), rotation: NDArray[np.float64] | None = None) -> Solid:
        """The solid rotated about the origin by ``rotation`` (3, 3), then shifted."""
        turned = self.vertices if rotation is None else self.vertices @ rotation.T
        return Solid(turned + np.asarray(translation), self.faces)


def merged(solids: Sequence[Solid]) -> Solid:
    """Several solids as one mesh; they may overlap."""
    offsets = np.cumsum([0, *(len(s.vertices) for s in solids[:-1])])
    faces = [s.faces + offset for s, offset in zip(solids, offsets, strict=True)]
    return Solid(np.vstack([s.vertices for s in solids]), np.vstack(faces))


def box(size: Vector) -> Solid:
    """A box of these edge lengths, centred on the origin."""
    profile = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * 0.5 * np.asarray(size[:2])
    return prism(profile, size[2])


def prism(profile: NDArray[np.float64], height: float) -> Solid:
    """A convex polygon (K, 2), counter-clockwise, extruded along z from -height / 2 to height / 2."""
    n = len(profile)
    low = np.column_stack([profile, np.full(n, -0.5 * height)])
    high = np.column_stack([profile, np.full(n, 0.5 * height)])
    return Solid(np.vstack([low, high]), _tube_faces(n))


def cone(radius_low: float, radius_high: float, height: float, sides: int = 24) -> Solid:
    """A truncated cone (a cylinder if the radii are equal) about z, from -height / 2 to height / 2."""
    angle = 2 * np.pi * np.arange(sides) / sides
    circle = np.column_stack([np.cos(angle), np.sin(angle)])
    low = np.column_stack([radius_low * circle, np.full(sides, -0.5 * height)])
    high = np.column_stack([radius_high * circle, np.full(sides, 0.5 * height)])
    return Solid(np.vstack([low, high]), _tube_faces(sides))


def dish(radius: float, depth: float, thickness: float, sides: int = 28, rings: int = 5) -> Solid:
    """A paraboloid bowl that opens towards +z, its vertex at the origin, with a wall of this thickness."""
    angle = 2 * np.pi * np.arange(sides) / sides
    circle = np.column_stack([np.cos(angle), np.sin(angle)])
    share = np.arange(1, rings + 1) / rings
    height = depth * share**2
    outer = [np.column_stack([s * radius * circle, np.full(sides, h)]) for s, h in zip(share, height, strict=True)]
    inner = [ring + np.array([0, 0, thickness]) for ring in outer]
    vertices = np.vstack([[[0, 0, 0]], *outer, [[0, 0, thickness]], *inner])
    first_inner = 1 + rings * sides
    below = _bowl_faces(0, sides, rings)[:, ::-1]
    above = _bowl_faces(first_inner, sides, rings)
    rim = _band_faces(1 + (rings - 1) * sides, first_inner + 1 + (rings - 1) * sides, sides)
    return Solid(vertices, np.vstack([below, above, rim]))


def rotation_about(axis: Vector, angle_deg: float) -> NDArray[np.float64]:
    """(3, 3) rotation about a unit axis (Rodrigues' formula)."""
    x, y, z = axis
    k = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    angle = np.deg2rad(angle_deg)
    return np.asarray(np.eye(3) + np.sin(angle) * k + (1 - np.cos(angle)) * (k @ k))


def _band_faces(low: int, high: int, n: int) -> NDArray[np.int64]:
    """Two rings of n vertices, from ``low`` and ``high`` on, joined; outward if ``high`` is above ``low``."""
    i = np.arange(n)
    j = (i + 1) % n
    one, two = np.column_stack([low + i, low + j, high + j]), np.column_stack([low + i, high + j, high + i])
    return np.vstack([one, two])


def _tube_faces(n: int) -> NDArray[np.int64]:
    fan = np.column_stack([np.zeros(n - 2, dtype=np.int64), np.arange(1, n - 1), np.arange(2, n)])
    return np.vstack([_band_faces(0, n, n), fan[:, ::-1], fan + n])


def _bowl_faces(centre: int, sides: int, rings: int) -> NDArray[np.int64]:
    """A centre vertex followed by rings; seen counter-clockwise from above."""
    i = np.arange(sides)
    fan = np.column_stack([np.full(sides, centre), centre + 1 + i, centre + 1 + (i + 1) % sides])
    bands = [_band_faces(centre + 1 + (r - 1) * sides, centre + 1 + r * sides, sides)[:, ::-1] for r in range(1, rings)]
    return np.vstack([fan, *bands])

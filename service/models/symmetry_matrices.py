"""The orthogonal matrices worth trying on a body."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from service.inference.state import Array

FOLDS = (2, 4, 3, 6, 8)  # in the order in which they join a symmetry group
ALIKE_DEG = 10.0  # closer than this, two matrices are two estimates of one symmetry
_SAME_AXES_DEG = 1.0
_MIRRORED = 1.9  # below 2, the least distance (Frobenius) of two orthogonal matrices of unlike determinants
# Of a prism of so many sides that is meant as such: light tells its sides apart. More are meant to be round.
_MOST_SIDES = 24
_LEAST_UNEVEN = 0.15  # share of the area: of an even spread of sides 0, of a prism's 1


def body_frames(triangles: Array) -> list[Array]:
    """(3, 3) frames, axes in rows: the body's own axes, and the principal axes of its surface (F, 3 corners, 3).

    The second moment of a triangle of area A with corners v is A / 12 (sum v v^T + (sum v)(sum v)^T).
    """
    area = np.linalg.norm(np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]), axis=1)
    corners = triangles - np.average(triangles.mean(axis=1), axis=0, weights=area)
    sums = corners.sum(axis=1)
    moment = np.einsum("f,fki,fkj->ij", area, corners, corners) + np.einsum("f,fi,fj->ij", area, sums, sums)
    _, axes = np.linalg.eigh(moment)
    same = np.abs(axes).max(axis=0).min() > np.cos(np.deg2rad(_SAME_AXES_DEG))
    return [np.eye(3)] if same else [np.eye(3), axes.T]


def matrices(frame: Array) -> list[Array]:
    """Mirrors across the frame's planes, half turns, the inversion, and 4-, 3-, 6- and 8-fold turns."""
    found = [np.eye(3) - 2 * np.outer(axis, axis) for axis in frame]
    found += [turn(axis, 2) for axis in frame]
    found.append(-np.eye(3))
    found += [turn(axis, fold) for fold in FOLDS[1:] for axis in frame]
    return found


def turn(axis: Array, fold: float) -> Array:
    """(3, 3) rotation by a ``fold``-th of a turn."""
    matrix = Rotation.from_rotvec(2 * np.pi / fold * np.asarray(axis)).as_matrix()
    return np.where(np.abs(matrix) < 1e-12, 0.0, matrix)


def angle_deg(a: Array, b: Array) -> float:
    """Angle between two orthogonal matrices of the same determinant; 180 if the determinants differ."""
    chord = float(np.linalg.norm(a - b))
    if chord > _MIRRORED and np.linalg.det(a) * np.linalg.det(b) < 0:
        return 180.0
    return float(np.rad2deg(2 * np.arcsin(min(1.0, chord / np.sqrt(8.0)))))


def mirrors_along(axis: Array, points: Array, fold: int) -> list[Array]:
    """Mirrors whose planes contain an axis about which the points (N, 3) have this rotation symmetry.

    The phase of the moment sum r^m exp(i m angle) with m = ``fold`` tells how the body is turned about the axis;
    a mirror plane must leave it, so it stands at that phase or half-way to the next.
    """
    u, v = _across(axis)
    flat = (points - points.mean(axis=0)) @ np.stack([u, v], axis=1)
    moment = np.sum((flat[:, 0] + 1j * flat[:, 1]) ** fold)
    angles = (np.angle(moment) + np.pi * np.arange(2)) / fold
    normals = [np.cos(a + np.pi / 2) * u + np.sin(a + np.pi / 2) * v for a in angles]
    return [np.eye(3) - 2 * np.outer(n, n) for n in normals]


def faces_all_ways(axis: Array, triangles: Array) -> bool:
    """Whether a surface (F, 3 corners, 3) faces all ways about an axis alike: no Fourier coefficient stands out."""
    doubled = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]) @ _across(axis).T
    area, angle = np.linalg.norm(doubled, axis=1), np.arctan2(doubled[:, 1], doubled[:, 0])
    waves = np.exp(1j * np.arange(1, _MOST_SIDES + 1)[:, None] * angle) @ area
    return bool(np.abs(waves).max() < _LEAST_UNEVEN * area.sum())


def _across(axis: Array) -> Array:
    """(2, 3) unit vectors across an axis and each other."""
    return np.asarray(np.linalg.svd(axis[None])[2][1:])

"""Silhouette twins: poses that no silhouette can tell apart.

An affine silhouette does not change under a depth reversal Z = diag(1, 1, -1). If the body has a mirror plane M,
R and Z R M show the same silhouette for every R; if it has a rotation symmetry S, so do R and R S. Joints may map
too: a panel mirrored with its body turns the other way, a flat panel looks the same after half a turn.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np

from service.inference.pose import conjugate, from_matrices, multiply, rotation_matrices
from service.inference.state import Array, Poses

_DEPTH = np.diag([1.0, 1.0, -1.0])  # exact: away from the camera and towards it


@dataclass(frozen=True)
class Symmetry:
    """Body point X -> matrix X + offset maps the body onto itself, joints moved from v to sign v + shift."""

    matrix: tuple[tuple[float, float, float], ...]  # (3, 3) orthogonal; determinant -1: a mirror plane
    offset: tuple[float, float, float] = (0.0, 0.0, 0.0)  # model units
    joint_sign: tuple[float, ...] = ()  # one per joint of the whole articulation, by position
    joint_shift: tuple[float, ...] = ()

    @cached_property
    def kind(self) -> str:
        """``mirror``, ``rotation``, or ``joint`` (the body stays, a joint value has a twin)."""
        m = np.asarray(self.matrix)
        if np.allclose(m, np.eye(3)):
            return "joint"
        return "mirror" if np.linalg.det(m) < 0 else "rotation"


def twin(poses: Poses, symmetry: Symmetry) -> Poses:
    """The poses (N) whose silhouettes are those of ``poses``, seen through ``symmetry``.

    R' = D R S^T with D = Z for a mirror and the identity otherwise; the offset is taken up by the position.
    """
    left, right = _factors(symmetry)
    quaternion = multiply(multiply(left, poses.quaternion), right)
    position, joints = poses.position, poses.joints
    if any(symmetry.offset):
        moved = rotation_matrices(quaternion) @ np.asarray(symmetry.offset)
        position = position - np.exp(poses.log_scale)[:, None] * moved[:, :2]
    if joints.shape[1]:
        joints = joints * np.asarray(symmetry.joint_sign) + np.asarray(symmetry.joint_shift)
    return Poses(quaternion, position, poses.log_scale, joints)


@lru_cache(maxsize=256)
def _factors(symmetry: Symmetry) -> tuple[Array, Array]:
    """Quaternions a and b such that a q b is the twin's: for a mirror Z R S^T = (-Z) R (-S)^T, three rotations."""
    s = np.asarray(symmetry.matrix)
    mirrored = np.linalg.det(s) < 0
    left = -_DEPTH if mirrored else np.eye(3)
    return from_matrices(left), conjugate(from_matrices(-s if mirrored else s))


def twin_rates(rates: Array, symmetry: Symmetry) -> Array:
    """(N, 6 + J) body-side rates of the twins: an angular velocity is an axial vector, w' = det(S) S w."""
    s = np.asarray(symmetry.matrix)
    out = rates.copy()
    out[:, :3] = np.linalg.det(s) * rates[:, :3] @ s.T
    if rates.shape[1] > 6:
        out[:, 6:] = rates[:, 6:] * np.asarray(symmetry.joint_sign)
    return out

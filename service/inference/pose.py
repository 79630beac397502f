"""Geometry of poses: quaternions, rotation vectors, and the tangent coordinates of a pose.

Quaternions are (..., 4) in the order w, x, y, z and mean body -> camera. A rotation is perturbed on the body
side: ``R exp([v]x)``.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from service.inference.state import Array, Poses


def rotation_matrices(quaternion: Array) -> Array:
    """(..., 4) unit quaternions -> (..., 3, 3) matrices."""
    w, x, y, z = _parts(quaternion)
    m = np.empty((*quaternion.shape[:-1], 3, 3))
    m[..., 0, 0] = 1 - 2 * (y * y + z * z)
    m[..., 0, 1] = 2 * (x * y - w * z)
    m[..., 0, 2] = 2 * (x * z + w * y)
    m[..., 1, 0] = 2 * (x * y + w * z)
    m[..., 1, 1] = 1 - 2 * (x * x + z * z)
    m[..., 1, 2] = 2 * (y * z - w * x)
    m[..., 2, 0] = 2 * (x * z - w * y)
    m[..., 2, 1] = 2 * (y * z + w * x)
    m[..., 2, 2] = 1 - 2 * (x * x + y * y)
    return m


def from_matrices(matrices: Array) -> Array:
    """(..., 3, 3) rotation matrices -> (..., 4) quaternions with w >= 0."""
    from scipy.spatial.transform import Rotation  # the web process, which restarts fast, seldom comes here

    q = Rotation.from_matrix(matrices.reshape(-1, 3, 3)).as_quat(canonical=True, scalar_first=True)
    return np.asarray(q, dtype=np.float64).reshape(*matrices.shape[:-2], 4)


def multiply(a: Array, b: Array) -> Array:
    """Hamilton product of (..., 4) quaternions, renormalised."""
    aw, ax, ay, az = _parts(a)
    bw, bx, by, bz = _parts(b)
    q = np.empty((*np.broadcast_shapes(a.shape, b.shape)[:-1], 4))
    q[..., 0] = aw * bw - ax * bx - ay * by - az * bz
    q[..., 1] = aw * bx + ax * bw + ay * bz - az * by
    q[..., 2] = aw * by - ax * bz + ay * bw + az * bx
    q[..., 3] = aw * bz + ax * by - ay * bx + az * bw
    q /= _length(q)
    return q


def _parts(q: Array) -> tuple[Array, Array, Array, Array]:
    """w, x, y and z of (..., 4)."""
    return q[..., 0], q[..., 1], q[..., 2], q[..., 3]


def _length(vector: Array) -> Array:
    """(..., 1) of (..., d)."""
    return np.asarray(np.sqrt(np.vecdot(vector, vector))[..., None], dtype=np.float64)


def conjugate(q: Array) -> Array:
    """Inverse of (..., 4) unit quaternions."""
    return np.asarray(q * np.array([1.0, -1.0, -1.0, -1.0]), dtype=np.float64)


def exp_so3(vector: Array) -> Array:
    """Rotation vectors (..., 3) in radians -> quaternions (..., 4)."""
    half = 0.5 * _length(vector)
    return np.concatenate([np.cos(half), 0.5 * np.sinc(half / np.pi) * vector], axis=-1)


def log_so3(q: Array) -> Array:
    """Quaternions (..., 4) -> rotation vectors (..., 3) in radians, of length at most pi."""
    q = np.where(q[..., :1] < 0, -q, q)
    sine = _length(q[..., 1:])
    angle = 2 * np.arctan2(sine, q[..., :1])
    ratio = np.where(sine > 1e-12, angle / np.maximum(sine, 1e-300), 2.0)
    return np.asarray(ratio * q[..., 1:], dtype=np.float64)


def angle_between(a: Array, b: Array) -> Array:
    """Geodesic angle in radians between quaternions (..., 4)."""
    dot = np.abs(np.sum(a * b, axis=-1))
    chord = np.minimum(_length(a - b), _length(a + b))[..., 0]
    # exact: either form; from 0.9 on the chord has more digits
    return np.asarray(np.where(dot < 0.9, 2 * np.arccos(np.clip(dot, 0, 1)), 4 * np.arcsin(chord / 2)))


def directions_apart(a: Array, b: Array) -> Array:
    """Angle in radians between vectors (..., 3)."""
    return np.asarray(np.arctan2(np.linalg.norm(np.cross(a, b), axis=-1), np.sum(a * b, axis=-1)))


def any_turns(rng: np.random.Generator, count: int) -> Array:
    """(count, 4) quaternions, uniform over all turns (Haar measure)."""
    drawn = rng.standard_normal((count, 4))
    return np.asarray(drawn / np.linalg.norm(drawn, axis=1, keepdims=True))


def retract(poses: Poses, delta: Array) -> Poses:
    """Move N poses by tangent steps (N, 6 + J): body-side rotation (rad), x, y (px), log scale, joints."""
    return Poses(
        multiply(poses.quaternion, exp_so3(delta[:, :3])),
        poses.position + delta[:, 3:5],
        poses.log_scale + delta[:, 5],
        poses.joints + delta[:, 6:],
    )


def local(origin: Poses, poses: Poses) -> Array:
    """Tangent coordinates (N, 6 + J) of ``poses`` seen from ``origin`` (N or 1 poses); inverse of ``retract``."""
    return np.concatenate(
        [
            log_so3(multiply(conjugate(origin.quaternion), poses.quaternion)),
            poses.position - origin.position,
            (poses.log_scale - origin.log_scale)[:, None],
            poses.joints - origin.joints,
        ],
        axis=1,
    )


def yaw_pitch_roll_deg(quaternion: Array) -> Array:
    """(..., 4) -> (..., 3) intrinsic Z-Y'-X'' angles: R = Rz(yaw) Ry(pitch) Rx(roll). For people only.

    At a pitch of +-90 degrees only yaw and roll together are defined: all of it is told as yaw, with no roll.
    """
    m = rotation_matrices(quaternion)
    cosine = np.hypot(m[..., 0, 0], m[..., 1, 0])
    locked = cosine < 1e-9
    yaw = np.where(locked, np.arctan2(-m[..., 0, 1], m[..., 1, 1]), np.arctan2(m[..., 1, 0], m[..., 0, 0]))
    pitch = np.arctan2(-m[..., 2, 0], cosine)
    roll = np.where(locked, 0.0, np.arctan2(m[..., 2, 1], m[..., 2, 2]))
    return np.asarray(np.rad2deg(np.stack([yaw, pitch, roll], axis=-1)), dtype=np.float64)


def concatenate(*batches: Poses) -> Poses:
    """Several batches as one."""
    return Poses(
        np.concatenate([b.quaternion for b in batches]),
        np.concatenate([b.position for b in batches]),
        np.concatenate([b.log_scale for b in batches]),
        np.concatenate([b.joints for b in batches]),
    )


def repeat(poses: Poses, count: int) -> Poses:
    """Each of K poses ``count`` times, in a row: K * count poses."""
    return poses[np.repeat(np.arange(len(poses)), count)]


def pick(condition: NDArray[np.bool_], a: Poses, b: Poses) -> Poses:
    """Per particle: ``a`` where the condition holds, else ``b``."""
    c = condition[:, None]
    return Poses(
        np.where(c, a.quaternion, b.quaternion),
        np.where(c, a.position, b.position),
        np.where(condition, a.log_scale, b.log_scale),
        np.where(c, a.joints, b.joints),
    )

"""A found pose against the true one: the figures every benchmark of this project reports."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gpu.lens import NO_LENS, Lens, seen_through
from gpu.mesh import Mesh
from gpu.zbuffer import rasterise
from service.inference.articulation import Articulation, Joint, part_transforms
from service.inference.pose import rotation_matrices
from service.inference.state import Array, Poses

_DEPTH_MIRROR = np.diag([1.0, 1.0, -1.0])


@dataclass(frozen=True)
class PoseErrors:
    """How far a pose is from the truth. Joints: the largest error, degrees or model units."""

    orientation_deg: float
    position_px: float
    scale_percent: float
    joint: float
    iou: float


def compare(
    mesh: Mesh,
    articulation: Articulation,
    truth: Poses,
    found: Poses,
    size: tuple[int, int],
    symmetries: Sequence[Array] = (),
) -> PoseErrors:
    """Errors of one pose in an image of ``size`` (width, height).

    ``symmetries`` are (3, 3) orthogonal matrices S that leave the body as it is. A rotation symmetry makes R and
    R S one pose; a mirror plane makes R and Z R S one silhouette, Z = diag(1, 1, -1).
    """
    seen, real = silhouette(mesh, articulation, found, size), silhouette(mesh, articulation, truth, size)
    union = int((seen | real).sum())
    joints = [
        joint_error(joint, float(a), float(b))
        for joint, a, b in zip(articulation.joints, found.joints[0], truth.joints[0], strict=True)
    ]
    return PoseErrors(
        orientation_deg=orientation_error_deg(truth.quaternion[0], found.quaternion[0], symmetries),
        position_px=float(np.linalg.norm(found.position[0] - truth.position[0])),
        scale_percent=100.0 * abs(float(np.expm1(found.log_scale[0] - truth.log_scale[0]))),
        joint=max(joints, default=0.0),
        iou=float((seen & real).sum()) / union if union else 1.0,
    )


def orientation_error_deg(truth: Array, found: Array, symmetries: Sequence[Array] = ()) -> float:
    """Geodesic angle between (4,) quaternions, the smallest over poses with the same silhouette."""
    real, seen = rotation_matrices(truth), rotation_matrices(found)
    alike = [real]
    for matrix in symmetries:
        turned = real @ matrix
        alike.append(turned if np.linalg.det(matrix) > 0 else _DEPTH_MIRROR @ turned)
    # The chord, unlike the trace, keeps its digits at small angles: |A - B|_F = 2 sqrt(2) sin(angle / 2).
    chords = [float(np.linalg.norm(seen - other)) / np.sqrt(8.0) for other in alike]
    return float(np.rad2deg(2 * np.arcsin(min(1.0, *chords))))


def joint_error(joint: Joint, found: float, truth: float) -> float:
    """Difference of two values of a joint, on its circle if it has one."""
    difference = abs(found - truth)
    if joint.period is None:
        return difference
    return abs((difference + 0.5 * joint.period) % joint.period - 0.5 * joint.period)


def silhouette(
    mesh: Mesh, articulation: Articulation, pose: Poses, size: tuple[int, int], lens: Lens = NO_LENS
) -> NDArray[np.bool_]:
    """(H, W) pixels whose centre the body at a pose (one of them) covers."""
    transforms = part_transforms(articulation, pose)[0].astype(np.float64)
    return np.asarray(rasterise(seen_through(mesh.placed(transforms), lens)[mesh.faces], *size).face >= 0)

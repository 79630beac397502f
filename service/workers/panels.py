"""Which way panels face, from their mesh: for joints that turn them towards the Sun."""

from __future__ import annotations

import numpy as np

from gpu.mesh import Mesh
from gpu.surface_groups import face_areas
from service.inference.articulation import Articulation, Joint
from service.inference.model.sun_tracking import SunTracking
from service.inference.params import JointParams
from service.inference.state import Array


def sun_tracking(mesh: Mesh, articulation: Articulation, told: JointParams) -> SunTracking | None:
    """What a session says of joints that follow the Sun; None: nothing. The largest part that each turns stands for it.

    ``articulation``: with the joints that are estimated, the named ones among them.
    """
    names = [joint.name for joint in articulation.joints]
    columns = sorted((names.index(name) for name in told.sun_tracking), key=lambda k: _depth(articulation.joints[k]))
    if not columns:
        return None
    panels = [_largest(mesh, articulation.joints[k]) for k in columns]
    numbers = tuple(articulation.parts.index(mesh.parts[p].name) for p in panels)
    normals = np.array([facing(mesh, p) for p in panels])
    return SunTracking(articulation, tuple(columns), numbers, normals, told.sun_tracking_sigma_deg)


def facing(mesh: Mesh, part: int) -> Array:
    """(3,) the line along which most of a part's surface faces, either way; joints at rest."""
    areas, normals = face_areas(mesh)[mesh.part_of == part], mesh.normals[mesh.part_of == part]
    return np.asarray(np.linalg.eigh(normals.T @ (areas[:, None] * normals))[1][:, -1])


def _largest(mesh: Mesh, joint: Joint) -> int:
    turned = {name for stage in joint.stages for name in stage.parts}
    areas = np.bincount(mesh.part_of, face_areas(mesh), len(mesh.parts))
    return max((p for p, part in enumerate(mesh.parts) if part.name in turned), key=lambda p: float(areas[p]))


def _depth(joint: Joint) -> int:
    return min(stage.depth for stage in joint.stages)

"""What moves on a model: from its file, or from a client's ``joints``, to an ``Articulation``.

A joint at 0 is the model as it is in the file. Axes and hinge points of the result are in the body frame at
rest (file coordinates minus the mesh centre).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from gpu.mesh import Mesh
from service.inference.articulation import Articulation
from service.models.glb import read_scene_tree
from service.models.requested_joints import joints_from_request
from service.models.scene_joints import joints_from_scene


@dataclass(frozen=True)
class ModelJoints:
    """The articulation of a model in the body frame, and what a user should know about how it was read."""

    articulation: Articulation
    warnings: tuple[str, ...] = ()


def read_joints(
    data: bytes, file_type: str, mesh: Mesh, joints: Sequence[Mapping[str, Any]] | None = None
) -> ModelJoints:
    """Joints of an uploaded file (``data``, of type "glb", "obj", ...) that ``mesh`` was made from.

    ``joints`` (contract form, file coordinates) replaces whatever the file carries; an empty list makes the
    model rigid. Raises ``JointError``; ``MeshFileError`` for a broken GLB.
    """
    parts, centre = tuple(part.name for part in mesh.parts), np.asarray(mesh.centre)
    if joints is not None:
        return ModelJoints(Articulation(parts, joints_from_request(joints, parts, centre)))
    if file_type.lower().lstrip(".") != "glb":
        return ModelJoints(Articulation(parts))
    found, warnings = joints_from_scene(read_scene_tree(data), parts, centre)
    return ModelJoints(Articulation(parts, found), warnings)

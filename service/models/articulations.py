"""What moves on a model: from its file, or from a client's ``joints``, to an ``Articulation``.

A joint at 0 is the model as it is in the file. Axes and hinge points of the result are in the body frame at
rest (file coordinates minus the mesh centre).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gpu.mesh import Mesh
from gpu.mesh_limits import MeshLimits
from gpu.urdf import read_urdf
from gpu.urdf_archive import unpack_urdf
from service.inference.articulation import Articulation, Joint
from service.models.glb import read_scene_tree
from service.models.requested_joints import joints_from_request
from service.models.scene_joints import joints_from_scene
from service.models.tied_joints import split_ties, tie_joints
from service.models.urdf_joints import joints_from_urdf


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
    model rigid; entries that only tie joints to one another leave the file's own and tie them.
    Raises ``JointError``; ``MeshFileError`` for a broken GLB.
    """
    parts, centre = tuple(part.name for part in mesh.parts), np.asarray(mesh.centre)
    definitions, ties = split_ties(joints or ())
    if joints is not None and (definitions or not ties):
        return ModelJoints(Articulation(parts, tie_joints(joints_from_request(definitions, parts, centre), ties)))
    found, warnings = _joints_of_file(data, file_type.lower().lstrip("."), parts, centre)
    return ModelJoints(Articulation(parts, tie_joints(found, ties)), warnings)


def _joints_of_file(
    data: bytes, file_type: str, parts: tuple[str, ...], centre: NDArray[np.float64]
) -> tuple[tuple[Joint, ...], tuple[str, ...]]:
    if file_type == "glb":
        return joints_from_scene(read_scene_tree(data), parts, centre)
    if file_type == "urdf":
        return joints_from_urdf(read_urdf(unpack_urdf(data)[0], MeshLimits()), parts, centre)
    return (), ()

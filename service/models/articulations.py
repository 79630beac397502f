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
from service.models.joint_fields import refused
from service.models.requested_joints import joints_from_request
from service.models.scene_joints import joints_from_scene
from service.models.tied_joints import split_ties, tie_joints
from service.models.urdf_joints import joints_from_urdf

DEFAULT_LIMITS = MeshLimits()
FARTHEST = 1e4  # radii of the body: an axis so far away is a mistake of units


@dataclass(frozen=True)
class ModelJoints:
    """The articulation of a model in the body frame, and what a user should know about how it was read."""

    articulation: Articulation
    warnings: tuple[str, ...] = ()


def read_joints(
    data: bytes,
    file_type: str,
    mesh: Mesh,
    joints: Sequence[Mapping[str, Any]] | None = None,
    limits: MeshLimits = DEFAULT_LIMITS,
) -> ModelJoints:
    """Joints of an uploaded file (``data``, of type "glb", "obj", ...) that ``mesh`` was made from.

    ``joints`` (contract form, file coordinates) replaces whatever the file carries; an empty list makes the
    model rigid; entries that only tie joints to one another leave the file's own and tie them.
    Raises ``JointError``; ``MeshFileError`` for a broken GLB; ``MeshLimitError`` for what is past ``limits``.
    """
    parts, centre = tuple(part.name for part in mesh.parts), np.asarray(mesh.centre)
    definitions, ties = split_ties(joints or ())
    warnings: tuple[str, ...] = ()
    if joints is not None and (definitions or not ties):
        found = joints_from_request(definitions, parts, centre, limits)
    else:
        found, warnings = _joints_of_file(data, file_type.lower().lstrip("."), parts, centre, limits)
    tied = tie_joints(found, ties)
    _require_near(tied, mesh.radius)
    return ModelJoints(Articulation(parts, tied), warnings)


def _require_near(joints: Sequence[Joint], radius: float) -> None:
    """Raises ``JointError`` for a joint with which the body would be somewhere else altogether."""
    for joint in joints:
        slide = max(abs(joint.minimum), abs(joint.maximum)) if joint.kind == "prismatic" else 0.0
        away = max(float(np.linalg.norm(stage.origin)) + stage.ratio * slide for stage in joint.stages)
        if not away <= FARTHEST * radius:
            raise refused(
                "joints",
                f"joint {joint.name!r} reaches {away:.3g} from the middle of a model whose radius is {radius:.3g}:"
                f" more than {FARTHEST:g} times as far",
            )


def _joints_of_file(
    data: bytes, file_type: str, parts: tuple[str, ...], centre: NDArray[np.float64], limits: MeshLimits
) -> tuple[tuple[Joint, ...], tuple[str, ...]]:
    if file_type == "glb":
        return joints_from_scene(read_scene_tree(data), parts, centre, limits)
    if file_type == "urdf":
        return joints_from_urdf(read_urdf(unpack_urdf(data)[0], limits), parts, centre, limits)
    return (), ()

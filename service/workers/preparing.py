"""What a worker finds in an uploaded model: its joints, its symmetries, and what its user should know."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from gpu.mesh import Mesh
from gpu.mesh_limits import MeshLimitError, MeshLimits
from service.models.articulations import read_joints
from service.models.symmetry import describe_symmetries, model_symmetries, with_periods
from service.workers.base import ModelJob, ModelReport
from service.workers.decoding import past_limit

MOST_WARNINGS = 100  # of one kind: a file may give cause for one in every part


def report_model(job: ModelJob, mesh: Mesh, limits: MeshLimits) -> ModelReport:
    """The report on a file that ``mesh`` was made from. Raises ``JointError``, ``MeshFileError``, ``TooLargeError``."""
    try:
        found = read_joints(job.data, job.file_type, mesh, job.joints, limits)
    except MeshLimitError as error:
        raise past_limit(error) from error
    same = model_symmetries(mesh, found.articulation)
    return ModelReport(
        faces=mesh.n_faces,
        vertices=mesh.n_vertices,
        size=mesh.size,
        centre=mesh.centre,
        watertight=mesh.watertight,
        articulation=replace(with_periods(found.articulation, same.joint_periods), round_axes=same.round_axes),
        symmetries=tuple(describe_symmetries(same.symmetries, found.articulation)),
        warnings=(*_first(mesh.warnings), *_first(found.warnings), *same.warnings),
        twins=same.symmetries,
    )


def _first(warnings: Sequence[str]) -> Sequence[str]:
    if len(warnings) <= MOST_WARNINGS:
        return warnings
    return [*warnings[:MOST_WARNINGS], f"and {len(warnings) - MOST_WARNINGS} more warnings like these"]

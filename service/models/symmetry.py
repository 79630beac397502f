"""Which symmetries of a body its silhouette keeps, found once per model.

A silhouette cannot tell R from Z R S where S is a mirror plane of the body, nor R from R S where S is one of its
rotation symmetries (``inference.symmetry``). Real bodies are only nearly symmetric, so a symmetry is what leaves
small silhouettes nearly the same from every side.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from gpu.mesh import Mesh
from service.inference.articulation import Articulation
from service.inference.revolution import Axis
from service.inference.state import Array
from service.inference.symmetry import Symmetry
from service.models.joint_fields import triple
from service.models.silhouettes import TooIntricateError
from service.models.symmetric_joints import extend, joint_twins, mirrored_rest
from service.models.symmetry_group import (
    FEW_ELEMENTS,
    MAX_ELEMENTS,
    contains,
    extended,
    identity,
    with_joint_twins,
)
from service.models.symmetry_matrices import (
    ALIKE_DEG,
    angle_deg,
    body_frames,
    faces_all_ways,
    matrices,
    mirrors_along,
    turn,
)
from service.models.symmetry_trials import Trials

_BETTER = 0.01  # by this much must a nearly equal matrix overlap more to take another's place


@dataclass(frozen=True)
class ModelSymmetries:
    """What was found. ``joint_periods``: degrees after which a joint's silhouette repeats; None: never.

    ``round_axes``: unit, about which a turn changes nothing that can be seen, be it by outline or by light.
    """

    symmetries: tuple[Symmetry, ...]
    joint_periods: tuple[float | None, ...]
    warnings: tuple[str, ...] = ()
    round_axes: tuple[Axis, ...] = ()


@dataclass(frozen=True)
class _Match:
    """A matrix through which the body at rest looks the same."""

    matrix: Array
    offset: Array
    overlap: float


def find_symmetries(mesh: Mesh, articulation: Articulation) -> tuple[Symmetry, ...]:
    """Every symmetry but the identity that the silhouette keeps, closed under composition (at most 47, a cube's).

    Joints are by position in ``articulation.joints``; a sign of 0 marks a symmetry that holds only while that
    joint stands at the value of its shift (``symmetry_group.held_symmetries`` sorts them out for a session).
    """
    return model_symmetries(mesh, articulation).symmetries


def find_joint_periods(mesh: Mesh, articulation: Articulation) -> tuple[float | None, ...]:
    """Per joint the degrees after which the silhouette repeats, whatever the other joints do; None: never."""
    return model_symmetries(mesh, articulation).joint_periods


def model_symmetries(mesh: Mesh, articulation: Articulation) -> ModelSymmetries:
    """All of it at once: symmetries, joint periods, and what a user should be warned of.

    Of a body too intricate for the search none are told, and a warning is.
    """
    try:
        return _searched(Trials(mesh, articulation))
    except TooIntricateError:
        given = tuple(joint.period for joint in articulation.joints)
        return ModelSymmetries((), given, (_too_intricate(mesh, articulation),))


def _searched(trials: Trials) -> ModelSymmetries:
    twins = joint_twins(trials)
    matches, round_axes = _matches(trials)
    bodies = _with_joints(trials, matches)
    group = _verified_group(trials, bodies, FEW_ELEMENTS if round_axes else MAX_ELEMENTS)
    joints = trials.articulation.joints
    triangles = _triangles(trials.mesh)
    truly = [not joints and faces_all_ways(axis, triangles) for axis in round_axes]
    warnings = [*twins.warnings, *(_round_warning(axis, one) for axis, one in zip(round_axes, truly, strict=True))]
    if not round_axes and not all(contains(group, symmetry, joints) for symmetry in bodies):
        warnings.append("the body has more symmetries than the tracker follows: equal views may be reported once")
    symmetries = with_joint_twins(group, twins.symmetries, joints)
    axes = tuple(triple(axis) for axis, one in zip(round_axes, truly, strict=True) if one)
    return ModelSymmetries(symmetries, twins.periods, tuple(warnings), axes)


def with_periods(articulation: Articulation, periods: Sequence[float | None]) -> Articulation:
    """The articulation with the period of each joint set."""
    joints = (replace(joint, period=period) for joint, period in zip(articulation.joints, periods, strict=True))
    return replace(articulation, joints=tuple(joints))


def describe_symmetries(symmetries: Sequence[Symmetry], articulation: Articulation) -> list[dict[str, Any]]:
    """JSON documents: kind, matrix, offset, and per joint name its sign and shift."""
    return [
        {
            "kind": s.kind,
            "matrix": [list(row) for row in s.matrix],
            "offset": list(s.offset),
            "joints": {
                joint.name: {"sign": int(sign), "shift": shift}
                for joint, sign, shift in zip(articulation.joints, s.joint_sign, s.joint_shift, strict=True)
            },
        }
        for s in symmetries
    ]


def _matches(trials: Trials) -> tuple[list[_Match], list[Array]]:
    """Matrices through which the body at rest looks the same, best of nearly equal ones; axes of round outlines."""
    whole = tuple(range(len(trials.mesh.parts)))
    points = np.vstack(trials.points)
    matches: list[_Match] = []
    round_axes: list[Array] = []
    for frame in body_frames(_triangles(trials.mesh)):
        for matrix in matrices(frame):
            _try(trials, matrix, whole, matches)
        for axis in frame:
            if any(abs(axis @ other) > np.cos(np.deg2rad(ALIKE_DEG)) for other in round_axes):
                continue
            if _found(matches, turn(axis, 8)) and trials.offset(turn(axis, 7), whole) is not None:
                round_axes.append(axis)
            elif not any(_is_mirror_along(m.matrix, axis) for m in matches):
                for fold in (3, 4):
                    if _found(matches, turn(axis, fold)):
                        for matrix in mirrors_along(axis, points, fold):
                            _try(trials, matrix, whole, matches)
    kept = [m for m in matches if not any(_is_fine_turn(m.matrix, axis) for axis in round_axes)]
    return kept, round_axes


def _triangles(mesh: Mesh) -> Array:
    return np.concatenate([part.vertices[part.faces] for part in mesh.parts])


def _try(trials: Trials, matrix: Array, parts: tuple[int, ...], matches: list[_Match]) -> None:
    """Add ``matrix`` to the matches if the body looks the same through it, in place of a worse one nearly equal."""
    near = [m for m in matches if angle_deg(m.matrix, matrix) < ALIKE_DEG]
    if any(m.overlap > 1 - _BETTER for m in near):
        return
    found = trials.offset(matrix, parts)
    if found is None or any(m.overlap + _BETTER > found[1] for m in near):
        return
    matches[:] = [m for m in matches if all(m is not n for n in near)] + [_Match(matrix, *found)]


def _with_joints(trials: Trials, matches: Sequence[_Match]) -> list[Symmetry]:
    """The matches with what they do to joint values; and matrices that fit once the joints have moved."""
    found = []
    for match in matches:
        symmetry = extend(trials, match.matrix, match.offset, trials.rest)
        if symmetry is not None:
            found.append(symmetry)
    if trials.articulation.n_joints:
        for frame in body_frames(_triangles(trials.mesh)):
            for matrix in matrices(frame):
                if any(angle_deg(np.asarray(s.matrix), matrix) < ALIKE_DEG for s in found):
                    continue
                seed = mirrored_rest(trials, matrix)
                symmetry = None if seed is None else extend(trials, matrix, *seed)
                if symmetry is not None:
                    found.append(symmetry)
    return found


def _verified_group(trials: Trials, generators: Sequence[Symmetry], limit: int) -> tuple[Symmetry, ...]:
    """The largest group that grows from the generators in order and whose every element looks the same."""
    joints = trials.articulation.joints
    group = [identity(len(joints))]
    for generator in generators:
        larger = extended(group, generator, joints, limit)
        new = [s for s in larger or () if s is not generator and not contains(group, s, joints)]
        if larger is not None and all(trials.holds(s) for s in new):
            group = larger
    return tuple(group[1:])


def _found(matches: Sequence[_Match], matrix: Array) -> bool:
    return any(angle_deg(m.matrix, matrix) < ALIKE_DEG for m in matches)


def _is_mirror_along(matrix: Array, axis: Array) -> bool:
    """A mirror whose plane contains the axis."""
    return bool(np.linalg.det(matrix) < 0 and np.allclose(matrix @ axis, axis, atol=0.1) and np.trace(matrix) > 0)


def _is_fine_turn(matrix: Array, axis: Array) -> bool:
    """A turn about the axis by no whole number of quarters: of a continuum, quarters are enough."""
    turned = np.linalg.det(matrix) > 0 and np.allclose(matrix @ axis, axis, atol=0.1)
    return bool(turned and min(angle_deg(matrix, turn(axis, fold)) for fold in (2, 4, -4)) > ALIKE_DEG)


def _too_intricate(mesh: Mesh, articulation: Articulation) -> str:
    return (
        f"the body ({mesh.n_faces} faces in {len(mesh.parts)} parts, {articulation.n_joints} joints) is too intricate"
        " to look for all its symmetries: poses that look equal may be reported once"
    )


def _round_warning(axis: Array, truly: bool) -> str:
    x, y, z = np.round(axis, 3) + 0.0
    if truly:
        return f"the body looks the same at every turn about the axis ({x:g}, {y:g}, {z:g}): that angle cannot be found"
    return f"the body's outline is the same at every turn about the axis ({x:g}, {y:g}, {z:g}): light alone tells it"

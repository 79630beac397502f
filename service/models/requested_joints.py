"""Joints that a client gives with an upload (the contract's ``joints`` array)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gpu.mesh_limits import MeshLimits, require
from service.inference.articulation import Joint, Stage
from service.models.joint_fields import (
    make_joint,
    number,
    range_of,
    refused,
    require_names,
    triple,
    vector,
)

_JOINT_KEYS = {"name", "kind", "parts", "axis", "origin", "min", "max", "initial"}


def joints_from_request(
    entries: Sequence[Mapping[str, Any]], parts: tuple[str, ...], centre: NDArray[np.float64], limits: MeshLimits
) -> tuple[Joint, ...]:
    """Joints in the contract's form. Applied in the listed order: the first entry moves its parts first.

    ``centre`` (3,) is the mesh centre in file coordinates. Raises ``JointError``, ``MeshLimitError``.
    """
    require(limits, joints=len(entries))
    joints: list[Joint] = []
    moves = 0
    for i, entry in enumerate(entries):
        where = f"joints[{i}]"
        if not isinstance(entry, Mapping):
            raise refused(where, "must be an object")
        unknown = sorted(set(entry) - _JOINT_KEYS)
        if unknown:
            known = ", ".join(sorted(_JOINT_KEYS))
            raise refused(f"{where}.{unknown[0]}", f"unknown field; known are {known}")
        joints.append(_requested_joint(entry, where, parts, centre, len(entries) - i))
        moves += len(joints[-1].stages[0].parts)
        require(limits, moves=moves)
    require_names(joints)
    return tuple(joints)


def _requested_joint(
    entry: Mapping[str, Any], where: str, parts: tuple[str, ...], centre: NDArray[np.float64], depth: int
) -> Joint:
    name, kind = entry.get("name"), entry.get("kind", "revolute")
    if not isinstance(name, str) or not name.strip():
        raise refused(f"{where}.name", "must be a non-empty string")
    if kind not in ("revolute", "prismatic"):
        raise refused(f"{where}.kind", f"{kind!r} is neither 'revolute' nor 'prismatic'")
    moved = entry.get("parts")
    if not isinstance(moved, Sequence) or isinstance(moved, str) or not moved:
        raise refused(f"{where}.parts", "must be a non-empty list of node names")
    known = set(parts)
    for part in moved:
        if not isinstance(part, str) or part not in known:
            raise refused(f"{where}.parts", f"{part!r} is no part of the model; it has {', '.join(parts)}")
    axis = vector(entry, "axis", where)
    length = float(np.linalg.norm(axis))
    if length == 0:
        raise refused(f"{where}.axis", "must not be zero")
    origin = triple(vector(entry, "origin", where, default=(0.0, 0.0, 0.0)) - centre)
    turn = kind == "revolute"
    low = number(entry, "min", where, default=-180.0 if turn else None)
    high = number(entry, "max", where, default=180.0 if turn else None)
    initial = number(entry, "initial", where, default=min(max(0.0, low), high))
    stage = Stage(
        "revolute" if turn else "prismatic", tuple(dict.fromkeys(moved)), triple(axis / length), origin, depth
    )
    return make_joint(name, stage.kind, range_of(low, high, initial, where), (stage,))

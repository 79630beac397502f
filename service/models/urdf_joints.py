"""Joints that a URDF file brings (http://wiki.ros.org/urdf/XML/joint), in degrees and metres."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gpu.mesh_limits import MeshLimits, require
from gpu.urdf import UrdfJoint, UrdfRobot
from service.inference.articulation import Joint, Stage
from service.models.joint_fields import make_joint, range_of, require_names, triple
from service.models.tied_joints import Tie, is_ratio, tie_joints

_REVOLUTE, _PRISMATIC = ("revolute", "continuous"), "prismatic"
_HALF_TURN_DEG = 180.0


def joints_from_urdf(
    robot: UrdfRobot, parts: tuple[str, ...], centre: NDArray[np.float64], limits: MeshLimits
) -> tuple[tuple[Joint, ...], tuple[str, ...]]:
    """One joint per movable joint of the file, and warnings. ``centre`` (3,) is the mesh centre in file coordinates.

    Values count from the file's zero position. A joint that mimics another is tied to it: its offset is in
    the position at rest. Raises ``JointError``, ``MeshLimitError``.
    """
    require(limits, joints=sum(item.kind != "fixed" for item in robot.joints))
    joints: list[Joint] = []
    moves = 0
    ties: list[Tie] = []
    warnings: list[str] = []
    names = {joint.name for joint in robot.joints}
    for item in robot.joints:
        if item.kind == "fixed":
            continue
        below = robot.below(item.child)
        moved = tuple(name for name in parts if name in below)
        moves += len(moved)
        require(limits, moves=moves)
        if item.kind not in (*_REVOLUTE, _PRISMATIC):
            warnings.append(f"joint {item.name!r} of type {item.kind!r} is held at its place")
        elif not moved:
            warnings.append(f"joint {item.name!r} moves no part and is ignored")
        else:
            joints.append(_joint(item, moved, centre, robot.depth(item.child)))
            if item.mimic is not None:
                leader, multiplier, _ = item.mimic
                if leader in names and is_ratio(multiplier):
                    ties.append(Tie(item.name, leader, multiplier, f"joint {item.name!r}"))
                else:
                    warnings.append(
                        f"joint {item.name!r} mimics {leader!r} with multiplier {multiplier:g}: it is taken as free"
                    )
    require_names(joints)
    return tie_joints(joints, ties), tuple(warnings)


def _joint(item: UrdfJoint, moved: tuple[str, ...], centre: NDArray[np.float64], depth: int) -> Joint:
    kind = "prismatic" if item.kind == _PRISMATIC else "revolute"
    axis = triple(item.place[:3, :3] @ np.asarray(item.axis))
    origin = triple(item.place[:3, 3] - centre)
    unit = float(np.rad2deg(1.0)) if kind == "revolute" else 1.0
    offset = item.mimic[2] if item.mimic is not None else 0.0
    if item.kind == "continuous" or item.lower is None or item.upper is None:
        low, high = (-_HALF_TURN_DEG, _HALF_TURN_DEG) if kind == "revolute" else (0.0, 0.0)
    else:
        low, high = unit * (item.lower - offset), unit * (item.upper - offset)
    bounds = range_of(low, high, min(max(0.0, low), high), f"joint {item.name!r}")
    stage = Stage("revolute" if kind == "revolute" else "prismatic", moved, axis, origin, depth)
    return make_joint(item.name, stage.kind, bounds, (stage,))

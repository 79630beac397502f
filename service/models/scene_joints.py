"""Joints that a GLB brings itself: the glTF vendor extension ``AGI_articulations``."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gpu.mesh_limits import MeshLimits, require
from service.inference.articulation import Joint, Kind, Stage
from service.models.glb import Node, SceneTree
from service.models.joint_fields import LARGEST_NUMBER, make_joint, number, range_of, refused, require_names, triple

EXTENSION = "AGI_articulations"
_AXES = {"x": (1.0, 0.0, 0.0), "y": (0.0, 1.0, 0.0), "z": (0.0, 0.0, 1.0)}
_STAGE_KINDS: dict[str, Kind] = {"Rotate": "revolute", "Translate": "prismatic"}
_CONFORMAL_TOLERANCE = 1e-4


def joints_from_scene(
    tree: SceneTree, parts: tuple[str, ...], centre: NDArray[np.float64], limits: MeshLimits
) -> tuple[tuple[Joint, ...], tuple[str, ...]]:
    """Joints of a GLB's ``AGI_articulations`` (Khronos glTF vendor extension), one per stage, and warnings.

    A node stands at ``parent * node * stage 1 * stage 2 ...``: so the last stage moves a point first, and a
    node deeper in the tree before its parents. Every node that names an articulation, with all its
    descendants, follows the same value. A joint is called as its articulation, or "articulation stage" where
    there are several stages. Scale stages change the shape, which no rigid pose can follow: they are left
    out, with a warning. ``centre`` (3,) is the mesh centre in file coordinates. Raises ``JointError``, and
    ``MeshLimitError`` before anything is placed.
    """
    definitions = _articulation_definitions(tree)
    require(limits, joints=sum(not _is_scale(stage) for d in definitions for stage in d.get("stages", ())))
    driven = _driven(tree, parts)
    warnings: list[str] = []
    joints: list[Joint] = []
    moves = 0
    most_stages = max((len(d.get("stages", ())) for d in definitions), default=0)
    for d, definition in enumerate(definitions):
        name = str(definition.get("name", ""))
        nodes = driven.get(name, ())
        stages = list(enumerate(definition.get("stages", ())))
        moving = [(k, stage) for k, stage in stages if not _is_scale(stage)]
        moves += len(moving) * sum(len(moved) for _, moved in nodes)
        require(limits, moves=moves)
        warnings.extend(
            f"articulation {name!r}: stage {stage.get('name')!r} changes the size and is ignored"
            for _, stage in stages
            if _is_scale(stage)
        )
        if definition.get("pointingVector") is not None:
            warnings.append(f"articulation {name!r}: its pointing vector is ignored; nothing here says where to point")
        if not nodes:
            warnings.append(f"articulation {name!r} moves no node and is ignored")
            continue
        for k, stage in moving:
            where = f"{EXTENSION}.articulations[{d}].stages[{k}]"
            title = name if len(moving) == 1 else f"{name} {stage.get('name', k)}"
            hinges = [Hinge(node, node.depth * most_stages + k, moved, centre) for node, moved in nodes]
            joint = _scene_joint(title, stage, where, hinges)
            if joint is None:
                warnings.append(f"joint {title!r} moves no part rigidly and is ignored")
            else:
                joints.append(joint)
    require_names(joints)
    return tuple(joints), tuple(warnings)


def _driven(tree: SceneTree, parts: tuple[str, ...]) -> dict[str, list[tuple[Node, tuple[str, ...]]]]:
    """Of each articulation the nodes that name it, in file order, each with the parts in its subtree."""
    order = {name: p for p, name in enumerate(parts)}
    found: dict[str, list[tuple[Node, tuple[str, ...]]]] = {}
    for node in tree.nodes:
        name = _articulation_of(node)
        if name is not None:
            moved = sorted(node.subtree & order.keys(), key=order.__getitem__)
            found.setdefault(name, []).append((node, tuple(moved)))
    return found


def _articulation_of(node: Node) -> str | None:
    entry = node.extensions.get(EXTENSION)
    name = entry.get("articulationName") if isinstance(entry, Mapping) else None
    return name if isinstance(name, str) else None


def _is_scale(stage: Mapping[str, Any]) -> bool:
    return str(stage.get("type", "")).endswith("Scale")


def _articulation_definitions(tree: SceneTree) -> list[Mapping[str, Any]]:
    root = tree.extensions.get(EXTENSION) or {}
    definitions = root.get("articulations", []) if isinstance(root, Mapping) else None
    if not isinstance(definitions, list) or not all(isinstance(d, Mapping) for d in definitions):
        raise refused(f"{EXTENSION}.articulations", "must be a list of objects")
    for d, definition in enumerate(definitions):
        stages = definition.get("stages", [])
        if not isinstance(stages, list) or not all(isinstance(s, Mapping) for s in stages):
            raise refused(f"{EXTENSION}.articulations[{d}].stages", "must be a list of objects")
    return definitions


@dataclass(frozen=True)
class Hinge:
    """Where a stage acts: a node, and in which place of the order (greater depth first)."""

    node: Node
    depth: int
    moved: tuple[str, ...]  # parts
    centre: NDArray[np.float64]  # (3,) file coordinates

    def place(self, kind: Kind, local_axis: tuple[float, float, float]) -> tuple[Stage, float] | None:
        """The stage in the body frame, and the model units of one unit of its value; None if not rigid."""
        if not self.moved:
            return None
        linear = self.node.world[:3, :3]
        direction = linear @ np.asarray(local_axis)
        length = float(np.linalg.norm(direction))
        if not 0 < length <= LARGEST_NUMBER:
            return None
        if kind == "prismatic":
            return Stage(kind, self.moved, triple(direction / length), depth=self.depth), length
        if not np.allclose(linear.T @ linear / length**2, np.eye(3), atol=_CONFORMAL_TOLERANCE):
            return None
        axis = direction / length * np.sign(np.linalg.det(linear))  # a mirrored node turns the other way
        origin = triple(self.node.world[:3, 3] - self.centre)
        return Stage(kind, self.moved, triple(axis), origin, self.depth), 1.0


def _scene_joint(title: str, stage: Mapping[str, Any], where: str, hinges: Sequence[Hinge]) -> Joint | None:
    kind_name = str(stage.get("type", ""))
    local_axis, kind = _AXES.get(kind_name[:1]), _STAGE_KINDS.get(kind_name[1:])
    if local_axis is None or kind is None:
        raise refused(f"{where}.type", f"{kind_name!r} is none of xRotate ... zTranslate")
    low = number(stage, "minimumValue", where)
    high = number(stage, "maximumValue", where)
    initial = number(stage, "initialValue", where, default=0.0)
    placed = [hinge.place(kind, local_axis) for hinge in hinges]
    found = [item for item in placed if item is not None]
    units = np.array([unit for _, unit in found])
    if not found or len(found) != len(placed) or np.ptp(units) > _CONFORMAL_TOLERANCE * units[0]:
        return None
    low, high, initial = (float(value * units[0]) for value in (low, high, initial))
    return make_joint(title, kind, range_of(low, high, initial, where), tuple(item for item, _ in found))

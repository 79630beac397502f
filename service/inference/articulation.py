"""Joints: from joint values to one rigid transform per part.

A joint drives one or more stages; a stage turns (or slides) some parts about an axis fixed at rest. Stages with
a greater ``depth`` are applied first, so a panel turns on its truss before the truss turns with it.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from service.inference.pose import rotation_matrices
from service.inference.state import Array, Poses

Kind = Literal["revolute", "prismatic"]


@dataclass(frozen=True)
class Stage:
    """One motion of some parts about (revolute) or along (prismatic) an axis given in the body frame at rest."""

    kind: Kind
    parts: tuple[str, ...]
    axis: tuple[float, float, float]  # unit
    origin: tuple[float, float, float] = (0.0, 0.0, 0.0)  # body frame, model units
    depth: int = 0  # deeper stages are applied first
    ratio: float = 1.0  # it moves by this times the joint's value


@dataclass(frozen=True)
class Joint:
    """A named variable: degrees (revolute) or model units (prismatic)."""

    name: str
    kind: Kind
    minimum: float
    maximum: float
    initial: float
    stages: tuple[Stage, ...]
    period: float | None = None  # the silhouette repeats after this many degrees (360 or less); None: never


@dataclass(frozen=True)
class Articulation:
    """The parts of a model, and the joints that move them. ``joints`` gives the order of the columns."""

    parts: tuple[str, ...]
    joints: tuple[Joint, ...] = ()
    held: tuple[tuple[Joint, float], ...] = ()  # joints that are not estimated, each at its value

    @property
    def n_joints(self) -> int:
        """Number of joints, J."""
        return len(self.joints)

    @property
    def spans(self) -> Array:
        """(J,) of the joints' ranges, deg or model units."""
        return np.array([joint.maximum - joint.minimum for joint in self.joints])

    @property
    def wrapping(self) -> NDArray[np.bool_]:
        """(J,) joints that turn all the way round."""
        return np.array(
            [joint.kind == "revolute" and joint.maximum - joint.minimum >= 360 for joint in self.joints], bool
        )

    @property
    def initial(self) -> Array:
        """(J,) values at rest."""
        return np.array([joint.initial for joint in self.joints], dtype=np.float64)


def hold(
    articulation: Articulation, free: Literal["all"] | Collection[str], fixed: Mapping[str, float]
) -> Articulation:
    """Keep the joints named in ``free`` as variables; hold the others at ``fixed`` or their initial value.

    Raises ``ValueError`` for a name that is no joint, one that is both free and fixed, or a value out of range.
    """
    names = [joint.name for joint in articulation.joints]
    wanted = [n for n in names if n not in fixed] if free == "all" else list(free)
    for name in [*wanted, *fixed]:
        if name not in names:
            raise ValueError(f"the model has no joint {name!r}; it has {', '.join(names) or 'none'}")
    for joint in articulation.joints:
        if joint.name in wanted and joint.name in fixed:
            raise ValueError(f"joint {joint.name!r} is both free and fixed")
        if joint.name in fixed and not joint.minimum <= fixed[joint.name] <= joint.maximum:
            raise ValueError(f"joint {joint.name!r} moves from {joint.minimum:g} to {joint.maximum:g}")
    return Articulation(
        articulation.parts,
        tuple(j for j in articulation.joints if j.name in wanted),
        (
            *articulation.held,
            *((j, float(fixed.get(j.name, j.initial))) for j in articulation.joints if j.name not in wanted),
        ),
    )


def part_transforms(articulation: Articulation, poses: Poses) -> np.ndarray[tuple[int, ...], np.dtype[np.float32]]:
    """Project every part of every particle: (N, P, 3, 4) float32, body point at rest -> (x px, y px, depth px).

    The affine camera of the paper: ``scale * (R X) + (x, y, 0)`` with X moved by the joints first.
    """
    rotation = rotation_matrices(poses.quaternion)  # (N, 3, 3)
    scale = np.exp(poses.log_scale)
    camera = np.zeros((len(poses), 3, 4))
    camera[:, :, :3] = scale[:, None, None] * rotation
    camera[:, :2, 3] = poses.position
    out = np.repeat(camera[:, None], len(articulation.parts), axis=1)
    for p, motion in enumerate(part_motions(articulation, poses.joints)):
        if motion is not None:
            out[:, p, :, :3] = camera[:, :, :3] @ motion[:, :3, :3]
            out[:, p, :, 3] = (camera[:, :, :3] @ motion[:, :3, 3:])[:, :, 0] + camera[:, :, 3]
    return np.ascontiguousarray(out, dtype=np.float32)


def part_motions(articulation: Articulation, values: Array) -> list[Array | None]:
    """Per part the (N, 4, 4) motion of its joints, or None where nothing moves it."""
    stages = [(s, values[:, j]) for j, joint in enumerate(articulation.joints) for s in joint.stages]
    stages += [(s, np.array([value])) for joint, value in articulation.held for s in joint.stages]
    stages.sort(key=lambda item: -item[0].depth)
    motions: list[Array | None] = [None] * len(articulation.parts)
    places = {name: p for p, name in enumerate(articulation.parts)}
    for stage, stage_values in stages:
        moved = stage_motion(stage, stage_values)
        for p in {places[name] for name in stage.parts if name in places}:
            before = motions[p]
            motions[p] = moved if before is None else moved @ before
    return motions


def stage_motion(stage: Stage, values: Array) -> Array:
    """(N, 4, 4) rigid motions of a stage at joint ``values`` (N,) degrees or model units (Rodrigues' formula)."""
    axis, values = np.asarray(stage.axis), stage.ratio * values
    out = np.tile(np.eye(4), (len(values), 1, 1))
    if stage.kind == "prismatic":
        out[:, :3, 3] = values[:, None] * axis
        return out
    angle = np.deg2rad(values)[:, None, None]
    k = np.array([[0, -axis[2], axis[1]], [axis[2], 0, -axis[0]], [-axis[1], axis[0], 0]])
    rotation = np.eye(3) + np.sin(angle) * k + (1 - np.cos(angle)) * (k @ k)
    origin = np.asarray(stage.origin)
    out[:, :3, :3] = rotation
    out[:, :3, 3] = origin - rotation @ origin
    return out

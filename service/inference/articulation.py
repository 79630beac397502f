"""Joints: from joint values to one rigid transform per part.

A joint drives one or more stages; a stage turns (or slides) some parts about an axis fixed at rest. Stages with
a greater ``depth`` are applied first, so a panel turns on its truss before the truss turns with it.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from service.inference.pose import rotation_matrices
from service.inference.revolution import Axis
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
    round_axes: tuple[Axis, ...] = ()  # about which a turn changes nothing that can be seen (``revolution``)

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

    @property
    def stages(self) -> list[tuple[int, Stage]]:
        """The stages of all joints, each with its joint's column."""
        return [(j, stage) for j, joint in enumerate(self.joints) for stage in joint.stages]

    @cached_property
    def chains(self) -> tuple[tuple[int | Array, ...], ...]:
        """(P) of each part what moves it, first to last: the number of a stage, or the (4, 4) motion of held ones."""
        links: list[tuple[Stage, int | Array]] = [(stage, k) for k, (_, stage) in enumerate(self.stages)]
        links += [(s, stage_motion(s, np.array([value]))[0]) for joint, value in self.held for s in joint.stages]
        chains: dict[str, list[int | Array]] = {name: [] for name in self.parts}
        for stage, link in sorted(links, key=lambda item: -item[0].depth):
            for name in chains.keys() & set(stage.parts):
                before = chains[name][-1] if chains[name] else 0
                if isinstance(link, int) or isinstance(before, int):
                    chains[name].append(link)
                else:
                    chains[name][-1] = link @ before
        return tuple(tuple(chain) for chain in chains.values())

    @cached_property
    def still(self) -> Array:
        """(4, P, 4) motions of the parts of which no joint is free, as what a camera is multiplied with."""
        held = [chain[0] if len(chain) == 1 else 0 for chain in self.chains]
        return np.stack([np.eye(4) if isinstance(one, int) else one for one in held], axis=1)

    def __getstate__(self) -> dict[str, object]:
        """Without what can be worked out again: jobs carry it to the workers."""
        return {name: vars(self)[name] for name in ("parts", "joints", "held", "round_axes")}


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
        articulation.round_axes,
    )


def part_transforms(articulation: Articulation, poses: Poses) -> np.ndarray[tuple[int, ...], np.dtype[np.float32]]:
    """Project every part of every particle: (N, P, 3, 4) float32, body point at rest -> (x px, y px, depth px).

    The affine camera of the paper: ``scale * (R X) + (x, y, 0)`` with X moved by the joints first.
    """
    n, n_parts = len(poses), len(articulation.parts)
    camera = np.zeros((n, 3, 4))
    camera[:, :, :3] = np.exp(poses.log_scale)[:, None, None] * rotation_matrices(poses.quaternion)
    camera[:, :2, 3] = poses.position
    seen = (camera.reshape(3 * n, 4) @ articulation.still.reshape(4, 4 * n_parts)).reshape(n, 3, n_parts, 4)
    out = np.ascontiguousarray(seen.swapaxes(1, 2), dtype=np.float32)
    for p, motion in enumerate(part_motions(articulation, poses.joints) if articulation.joints else ()):
        if motion is not None and any(isinstance(link, int) for link in articulation.chains[p]):
            out[:, p] = camera @ motion
    return out


def part_motions(articulation: Articulation, values: Array) -> list[Array | None]:
    """Per part the (N or 1, 4, 4) motion of its joints, or None where nothing moves it."""
    stages = articulation.stages
    moved = stage_motions([stage for _, stage in stages], values[:, [column for column, _ in stages]]) if stages else ()
    motions: list[Array | None] = []
    for chain in articulation.chains:
        motion: Array | None = None
        for link in chain:
            after = moved[link] if isinstance(link, int) else link[None]
            motion = after if motion is None else after @ motion
        motions.append(motion)
    return motions


def stage_motion(stage: Stage, values: Array) -> Array:
    """(N, 4, 4) rigid motions of a stage at joint ``values`` (N,) degrees or model units."""
    return np.asarray(stage_motions([stage], values[:, None])[0], dtype=np.float64)


def stage_motions(stages: Sequence[Stage], values: Array) -> Array:
    """(K, N, 4, 4) of K stages at values (N, K) of their joints (Rodrigues' formula)."""
    axes, origins = (np.array([getattr(s, name) for s in stages]).reshape(-1, 3) for name in ("axis", "origin"))
    slides = np.array([stage.kind == "prismatic" for stage in stages], dtype=bool)
    by = (values * [stage.ratio for stage in stages]).T  # (K, N)
    x, y, z = axes.T
    cross = np.zeros((len(stages), 1, 3, 3))
    cross[:, 0, [0, 0, 1, 1, 2, 2], [1, 2, 0, 2, 0, 1]] = np.stack([-z, y, z, -x, -y, x], axis=1)
    angle = np.deg2rad(np.where(slides[:, None], 0.0, by))[..., None, None]
    rotation = np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * (cross @ cross)
    out = np.zeros((*by.shape, 4, 4))
    out[..., :3, :3], out[..., 3, 3] = rotation, 1.0
    place = origins[:, None] - (rotation @ origins[:, None, :, None])[..., 0]
    out[..., :3, 3] = np.where(slides[:, None, None], by[..., None] * axes[:, None], place)
    return out

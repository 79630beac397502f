"""What is tracked: a model, frames in order, and the truth of each. Frames are made or read when they are asked for."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import PurePath
from typing import Any

import numpy as np

from gpu.mesh import Mesh, load_mesh
from service.inference.articulation import Articulation
from service.inference.light import Light
from service.inference.state import Array, Poses
from service.inference.symmetry import Symmetry
from service.workers.base import ModelJob
from service.workers.tracker import Tracker, content_key


@dataclass(frozen=True)
class Model:
    """A prepared model, and its mesh for drawing the truth."""

    name: str
    data: bytes
    file_type: str
    key: str
    mesh: Mesh
    articulation: Articulation  # with the periods of its joints
    twins: tuple[Symmetry, ...]


@dataclass(frozen=True)
class TruthFrame:
    """The true pose of a frame. ``joints`` names those that are known; the others are at rest."""

    time_s: float
    quaternion: Array  # (4,) w, x, y, z, body to camera
    position: Array  # (2,) px
    scale: float  # px per model unit
    joints: Mapping[str, float]
    visible: bool
    light: Light | None = None  # as a session knows it; None: alike in all frames

    def poses(self, articulation: Articulation) -> Poses:
        """A batch of one, its joints in the order of ``articulation``."""
        joints = np.array([[self.joints.get(joint.name, joint.initial) for joint in articulation.joints]])
        return Poses(self.quaternion[None], self.position[None], np.log([self.scale]), joints.reshape(1, -1))


@dataclass(frozen=True)
class Case:
    """One pass. ``backgrounds`` and ``frames`` start anew at every call; images are PNG files.

    Without a background the sky is learned from the first frame, outside of ``box`` or in its border.
    """

    name: str
    model: Model
    free: tuple[str, ...]  # joints to estimate
    size: tuple[int, int]  # width, height
    backgrounds: Callable[[], Iterable[bytes]]
    frames: Callable[[], Iterator[tuple[bytes, TruthFrame]]]
    symmetries: tuple[Array, ...] | None = None  # (3, 3) each; None: the model's own twins
    facts: Mapping[str, float] = field(default_factory=dict)  # known conditions, such as ``d_over_r0``
    towards_sun: Array | None = None  # (3,) camera axes: x right, y down, z away
    box: tuple[float, float, float, float] | None = None  # x, y, width, height about the body in the first frame
    scale_prior: tuple[float, float] | None = None  # px per model unit, and its relative error, as a range would tell
    mesh_error: float = 0.0  # relative, of the model's file as the body's shape


class ModelShelf:
    """Models by content: many passes share one, and its symmetries take seconds to find."""

    def __init__(self, tracker: Tracker) -> None:
        self._tracker = tracker
        self._models: dict[tuple[str, str], Model] = {}

    def model(self, name: str, data: bytes, joints: tuple[Mapping[str, Any], ...] | None = None) -> Model:
        """Prepare a mesh file. ``joints`` as in an upload; None: the file's own. Raises ``MeshFileError``."""
        key = content_key(data)
        shelf = (key, repr(joints))
        if shelf not in self._models:
            file_type = PurePath(name).suffix.lower().removeprefix(".")
            report = self._tracker.prepare_model(ModelJob(data, file_type, joints))
            mesh = load_mesh(data, file_type)
            self._models[shelf] = Model(name, data, file_type, key, mesh, report.articulation, report.twins)
        return self._models[shelf]

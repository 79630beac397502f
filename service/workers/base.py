"""What goes into a worker and what comes out: plain data, so that thread, process and remote actor are alike.

A worker keeps only caches that can be rebuilt, keyed by content hash. A job that names a blob (model file,
background) which the worker has not seen yet, and which ``blobs`` does not bring, raises
``MissingBlobError``.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal, Protocol

import numpy as np
from numpy.typing import NDArray

from service.inference.articulation import Articulation
from service.inference.belief import Belief
from service.inference.held import Held
from service.inference.light import Light
from service.inference.params import SessionConfig
from service.inference.smoothed import SmoothedEstimate
from service.inference.spin.basins import PassMotion
from service.inference.state import Estimate, FilterState
from service.inference.symmetry import Symmetry


@dataclass(frozen=True)
class ModelJob:
    """Prepare a model from an uploaded file."""

    data: bytes
    file_type: str  # "glb", "obj", "stl", "ply"
    joints: tuple[Mapping[str, Any], ...] | None = None  # contract form, file coordinates; None: from the file


@dataclass(frozen=True)
class ModelReport:
    """What was found in a model file. ``articulation`` is in body coordinates."""

    faces: int
    vertices: int
    size: tuple[float, float, float]
    centre: tuple[float, float, float]
    watertight: bool
    articulation: Articulation
    symmetries: tuple[Mapping[str, Any], ...] = ()  # as the API shows them
    warnings: tuple[str, ...] = ()
    twins: tuple[Symmetry, ...] = ()  # the same, as the filter takes them; joints by position in ``articulation``


@dataclass(frozen=True)
class BackgroundJob:
    """Learn one more background image (or all frames of a multi-frame file)."""

    config: SessionConfig
    body: bytes
    media_type: str
    background: bytes | None  # what was learned so far (opaque), or None
    box: tuple[float, float, float, float] | None = None  # x, y, w, h: learn outside of it
    border_px: float | None = None  # learn from the border only
    own: bool = False  # it shows the object: learn from what lies around that
    size: tuple[int, int] | None = None  # width and height that the image must have


@dataclass(frozen=True)
class BackgroundReport:
    """The background after the job: opaque bytes, to be stored and handed back by content hash."""

    background: bytes
    frames: int
    height: int  # of the whole frame
    width: int
    channels: int
    bits: int


@dataclass(frozen=True)
class ReadyJob:
    """Frames of a session will come: prepare what they need of its body, and under its Sun if that is told."""

    config: SessionConfig
    model: str  # key of the model file in ``blobs``
    file_type: str
    articulation: Articulation
    light: Light | None
    blobs: Mapping[str, bytes] = field(default_factory=dict)


@dataclass(frozen=True)
class FrameJob:
    """Track one frame. ``state`` is None before the first."""

    config: SessionConfig
    model: str  # key of the model file in ``blobs``
    file_type: str
    articulation: Articulation
    background: str  # key of the background in ``blobs``
    state: FilterState | None
    frame_index: int
    time_s: float  # of this frame, seconds since the epoch or since the first frame
    body: bytes
    media_type: str
    blobs: Mapping[str, bytes] = field(default_factory=dict)
    twins: tuple[Symmetry, ...] = ()  # symmetries of the model, joints by position in ``articulation``
    size: tuple[int, int] | None = None  # width and height that the frame must have; None: what fits the background
    scale_px: tuple[float, float] | None = None  # bounds known for this frame, px of the whole frame per model unit
    light: Light | None = None  # what is known of it before the frame is looked at
    held: Held | None = None  # the attitude mode that was told


@dataclass(frozen=True)
class FrameReport:
    """The new state, and the answer."""

    state: FilterState
    estimate: Estimate
    timing_ms: Mapping[str, float]  # decode, measure, score, total
    scorer: str
    belief: Belief | None = None  # the particles as modes, for the smoother


@dataclass(frozen=True)
class PackedFrameJob:
    """A frame on its way: the state as bytes (``service.workers.codec``), ``job.state`` left None."""

    job: FrameJob
    state: bytes | None


@dataclass(frozen=True)
class PackedFrameReport:
    """A frame's report on its way back: the new state as bytes."""

    state: bytes
    estimate: Estimate
    timing_ms: Mapping[str, float]
    scorer: str
    belief: bytes | None = None


@dataclass(frozen=True)
class RestoreJob:
    """Check a background and a packed state that come from another server."""

    config: SessionConfig
    background: bytes | None
    size: tuple[int, int] | None  # of the whole frames, width and height; None without a background
    state: bytes | None
    n_joints: int  # free ones


@dataclass(frozen=True)
class RestoreReport:
    """What they are; None where there is no state."""

    background_frames: int = 0
    channels: int | None = None
    bits: int | None = None
    frame_index: int | None = None
    time_s: float | None = None
    status: str | None = None


Shown = Literal["frame", "overlay", "model", "residual"]
"""A frame alone; with its silhouette (the paper's Table 1); as the model lights it; what that leaves of it."""


@dataclass(frozen=True)
class OverlayJob:
    """Draw a frame, and what an estimate says of it, as PNG: see ``Shown``."""

    model: str
    file_type: str
    articulation: Articulation
    body: bytes
    media_type: str
    quaternion: NDArray[np.float64]  # (4,)
    position: NDArray[np.float64]  # (2,)
    scale: float
    joints: NDArray[np.float64]  # (J,)
    config: SessionConfig
    background: str | None = None  # of ``model`` and ``residual``
    sun: NDArray[np.float64] | None = None  # (3,) towards the Sun in the image's axes; None: not known
    show: tuple[Shown, ...] = ("overlay",)
    blobs: Mapping[str, bytes] = field(default_factory=dict)


@dataclass(frozen=True)
class MeshJob:
    """Write a model's prepared mesh as GLB, in the body frame, one node per part.

    ``root``: below one that turns it by x, y, z, w.
    """

    model: str
    file_type: str
    blobs: Mapping[str, bytes] = field(default_factory=dict)
    root: tuple[float, float, float, float] | None = None


@dataclass(frozen=True)
class SmoothJob:
    """Smooth a pass. ``beliefs`` are packed, in the order of their frames; None where a frame's is not known."""

    config: SessionConfig
    articulation: Articulation
    twins: tuple[Symmetry, ...]  # joints by position in ``articulation``
    width: int  # of the whole frame
    height: int
    beliefs: tuple[bytes | None, ...]
    count: int  # frames to answer, from the first on; the others are only what came after
    radius: float = 1.0  # of the body, model units: by which the place of one that is not its mesh is off


@dataclass(frozen=True)
class SmoothReport:
    """One entry for each frame asked for; None where nothing is known but the filter's own answer."""

    estimates: tuple[SmoothedEstimate | None, ...]


@dataclass(frozen=True)
class MotionJob:
    """The motion of a pass: of every frame its packed belief (None: nothing known) and whether it counts.

    ``references``: of ``inference.spin.attitude_modes``; with ``cameras`` only.
    """

    config: SessionConfig
    model: str  # key of the model file in ``blobs``
    file_type: str
    articulation: Articulation
    twins: tuple[Symmetry, ...]  # joints by position in ``articulation``
    width: int  # of the whole frame
    height: int
    beliefs: tuple[bytes | None, ...]
    counts: tuple[bool, ...]
    cameras: tuple[NDArray[np.float64], ...] | None = None  # (4,) camera -> GCRF of every frame; None: not known
    references: Mapping[str, NDArray[np.float64]] | None = None  # (frames, 3, 3) reference -> GCRF, by attitude mode
    blobs: Mapping[str, bytes] = field(default_factory=dict)
    others: tuple[MotionJob, ...] = ()  # of other telescopes that saw the same object, cameras known in all of them
    offset_s: float = 0.0  # from the time of the beliefs to that of the answer


class Worker(Protocol):
    """Runs jobs one at a time. Raises ``service.errors.SkyposeError`` for anything the caller should hear."""

    def prepare_model(self, job: ModelJob) -> ModelReport:
        """Load, check and describe a model file."""

    def learn_background(self, job: BackgroundJob) -> BackgroundReport:
        """Decode an image and add it to the background."""

    def ready(self, job: ReadyJob) -> None:
        """Prepare what a session's frames will need."""

    def track(self, job: FrameJob) -> FrameReport:
        """Decode a frame, measure it, and run one step of the filter."""

    def overlay(self, job: OverlayJob) -> tuple[bytes, ...]:
        """PNGs of a frame as ``job.show`` asks, in its order."""

    def mesh(self, job: MeshJob) -> bytes:
        """GLB of a model's prepared mesh."""

    def restore(self, job: RestoreJob) -> RestoreReport:
        """Check what a checkpoint brings. Raises ``CheckpointError``."""

    def smooth(self, job: SmoothJob) -> SmoothReport:
        """Backwards over a pass that was tracked."""

    def motion(self, job: MotionJob) -> PassMotion:
        """How the object turned over a pass. Raises ``ConflictError`` for too few frames."""

    def describe(self) -> Mapping[str, Any]:
        """Devices, scorer, versions, for ``/v1/system``."""

    def wake(self) -> None:
        """Jobs will come: begin what they need and a spare does without. Does not wait for it."""

    def close(self) -> None:
        """Release the device."""

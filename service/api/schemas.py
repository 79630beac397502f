"""The wire: every JSON document of the API. Conventions of axes, units and angles: docs/conventions.md."""

from __future__ import annotations

from typing import Annotated, Any, Literal, Self

from pydantic import ConfigDict, Field, create_model, model_validator

from service.api.existence import Fit, Probabilities, RankedModel, Status
from service.api.rates import Rates
from service.api.sections import SECTIONS
from service.api.sky import Attitude, Camera, Light, Orbit
from service.api.wire import Described, Orientation, Wire


class Problem(Described):
    """RFC 9457 problem document. Further members say which limit, which setting, what was expected."""

    model_config = ConfigDict(extra="allow")

    type: str
    """Stable name of the kind of problem."""
    title: str
    """The same for people."""
    status: int
    """HTTP status."""
    detail: str
    """What is wrong in this call."""
    field: str | None = None
    """Which part of the request."""


class Pose(Wire):
    """Body point X lands at scale_px * (R X)_xy + (x_px, y_px)."""

    orientation: Orientation
    yaw_deg: float
    pitch_deg: float
    roll_deg: float
    x_px: float
    y_px: float
    scale_px: float
    """Pixels per model unit."""
    joints: dict[str, float]
    """Degrees (revolute) or model units (prismatic), of the estimated and the fixed joints."""
    attitude: Attitude | None = None
    """Absolute attitude, where the camera's is known."""


class BestPose(Pose):
    """The pose of the heaviest mode; with `bootstrap` the particle of highest likelihood in this frame."""

    log_likelihood: float | None
    """Null in smoothed estimates: their poses were never scored."""


class Spread(Wire):
    """Standard deviations about a mean: of one mode, or of all particles; the field says which."""

    orientation_deg: float
    """Weighted RMS geodesic angle."""
    yaw_deg: float
    pitch_deg: float
    roll_deg: float
    x_px: float
    y_px: float
    scale_px: float
    joints: dict[str, float]


class FullSpread(Spread):
    """With the covariance about the same mean."""

    covariance: list[list[float]]
    covariance_order: list[str]


class Mode(Wire):
    """A cluster of the posterior."""

    weight: float
    pose: Pose
    spread: Spread


class Estimate(Wire):
    """The answer to a frame."""

    session_id: str
    index: int
    time: str
    status: Status
    duplicate: bool
    """True where the frame had been answered before."""
    mean: Pose
    """Eq. 5 over all particles, the rotation averaged on SO(3)."""
    best: BestPose
    spread: FullSpread
    """`mixture`: within the mode of `best`. `bootstrap`: over all particles."""
    modes: list[Mode]
    """Their weights are probabilities, given that the model fits."""
    probabilities: Probabilities | None = None
    """Of `mixture` only."""
    fit: Fit | None = None
    """Of `mixture` only: how well the best mode explains the light."""
    spread_all: FullSpread | None = None
    """Of `mixture` only: over all particles, where `spread` is that of the best mode."""
    rates: Rates | None = None
    """Null in the first frame, and with a motion that has no rates."""
    models: list[RankedModel] | None = None
    """Only in a session that compares models: most probable first; the estimate is that of the first."""
    smoothed: bool | None = None
    """With `?smoothed=true` only: whether later frames could be taken into account."""
    camera: Camera | None = None
    """Where the camera's orientation is known."""
    orbit: Orbit | None = None
    """Where `prior.orbit` was given."""
    light: Light = Field(default_factory=Light)
    particles: int
    ess: float
    log_evidence: float
    timing_ms: dict[str, float]
    scorer: str
    assumed: list[Literal["background", "time", "attitude_mode"]] = Field(default_factory=list)
    """What nobody told: `background`, the sky was learned from around the object; `time`, the frame brought none. And
    what the session told: `attitude_mode`, by `prior.attitude_mode` poses that are aligned go before others."""
    warnings: list[str] = Field(default_factory=list)
    """What does not agree: site, time, orbit, pointing and the scale that is seen."""


class EstimateList(Wire):
    """A page of estimates."""

    estimates: list[Estimate]
    next: str | None


class Stage(Wire):
    """One motion of a joint, in file coordinates."""

    kind: Literal["revolute", "prismatic"]
    parts: list[str]
    axis: list[float]
    origin: list[float]
    depth: int
    """Deeper stages, of all joints together, are applied first."""
    ratio: float = 1.0
    """It moves by this times the joint's value."""


class Joint(Stage):
    """A joint; kind, parts, axis and origin are those of its first stage."""

    name: str
    min: float
    max: float
    initial: float
    period: float | None
    """The silhouette repeats after so many degrees; null: unknown or never."""
    stages: list[Stage]


class Model(Wire):
    """A model as it was prepared."""

    model_id: str
    """Hash of the file and the joints."""
    name: str
    file_type: str
    faces: int
    vertices: int
    size: list[float]
    """Of the bounding box at rest, model units."""
    centre: list[float]
    """Of that box in file coordinates: the origin of the body frame."""
    watertight: bool
    parts: list[str]
    joints: list[Joint]
    symmetries: list[dict[str, Any]]
    warnings: list[str]
    created_at: str


class ModelList(Wire):
    """A page of models, and the ids of those that are left out: what is stored of them is damaged."""

    models: list[Model]
    damaged: list[str] = Field(default_factory=list)
    next: str | None


class BackgroundResult(Wire):
    """What is known of the background now."""

    background_frames: int
    state: Literal["waiting_for_background", "ready"]


class Submission(Wire):
    """A frame that was taken but is not answered yet."""

    session_id: str
    key: str
    """Its idempotency key."""
    state: Literal["pending"] = "pending"
    location: str
    """Where the estimate will be."""


class _SessionHead(Wire):
    model_id: str | None = None
    """From the model's upload."""
    model_ids: Annotated[list[str], Field(min_length=2, max_length=16)] | None = None
    """Instead: the models that the object may be. Every frame costs as much as it does under all of them."""
    name: Annotated[str, Field(max_length=200)] | None = None
    """For people."""
    background: Literal["posted", "auto"] | None = None
    """`auto`: no empty frame will be posted. The same as `camera.background`."""

    @model_validator(mode="after")
    def _one_or_several(self) -> Self:
        if (self.model_id is None) == (self.model_ids is None):
            raise ValueError("give either model_id or model_ids")
        if self.model_ids is not None and len(set(self.model_ids)) < len(self.model_ids):
            raise ValueError("model_ids names a model twice")
        return self


SessionRequest = create_model("SessionRequest", __base__=_SessionHead, **SECTIONS)
"""A new session; what is left out comes from the preset."""


class Session(Wire):
    """A session with its whole effective configuration."""

    session_id: str
    name: str | None
    model_id: str | None
    """Null where models are compared."""
    model_ids: list[str] | None = None
    """The models that are compared."""
    state: Literal["waiting_for_background", "ready"]
    status: Status | None
    """Of the last estimate."""
    frames: int
    """Frames tracked so far: the next frame's index."""
    last_seq: int
    """Number of the newest event of the stream."""
    background_frames: int
    background: dict[str, Any] | None
    """Height, width, channels and bits that every frame must have."""
    created_at: str
    updated_at: str
    ended_at: str | None = None
    """It takes no more frames since then: nobody sent any for long (`SKYPOSE_END_IDLE_DAYS`)."""
    warnings: list[str]
    filter: dict[str, Any]
    likelihood: dict[str, Any]
    prior: dict[str, Any]
    motion: dict[str, Any]
    camera: dict[str, Any]
    joints: dict[str, Any]
    light: dict[str, Any]
    links: dict[str, str]


class SessionList(Wire):
    """A page of sessions, and the ids of those that are left out: what is stored of them is damaged."""

    sessions: list[Session]
    damaged: list[str] = Field(default_factory=list)
    next: str | None


class System(Wire):
    """What the service runs on."""

    name: str
    version: str
    started_at: str
    uptime_s: float
    worker: dict[str, Any]
    """Devices, scorer and versions, as a worker sees them."""
    workers: list[dict[str, Any]]
    sessions: int
    settings: dict[str, Any]

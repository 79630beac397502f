"""The motion of a pass: on the wire (docs/motion.md)."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from service.api.wire import Orientation, Wire


class Vector(Wire):
    """Three components."""

    x: float
    y: float
    z: float


class MotionProbabilities(Wire):
    """Of the laws of motion; they sum to 1."""

    constant_rate: float
    tumbling: float


class MotionFrames(Wire):
    """What the answer rests on."""

    stored: int
    used: int
    """In which the object is seen."""
    explained: float
    """Share of the frames used that one of their modes is of this motion."""


class MotionAlternative(Wire):
    """A course of orientations that the frames may be of."""

    probability: float
    model: Literal["constant_rate", "tumbling"]
    angular_velocity_body_deg_s: Vector
    sigma_deg_s: Vector
    period_s: float | None
    axis_gcrf: Vector | None
    orientation: Orientation


class Inertia(Wire):
    """Moments of inertia of a body that turns freely."""

    ratios: list[float]
    """The least and the middle principal moment over the greatest."""
    ratios_sigma: list[float]
    axes_body: list[list[float]]
    """Their axes in the body frame, least moment first."""
    masses: Literal["free", "mesh"]
    """What was believed of the masses before: nothing, or those of a shell of the mesh's shape."""
    nutation_deg: float
    """Between the angular velocity and the angular momentum, at the epoch."""
    nutation_sigma_deg: float


class AttitudeModeProbabilities(Wire):
    """All as likely before; they sum to 1."""

    inertially_fixed: float
    nadir_pointing: float
    yaw_steering: float
    sun_pointing: float
    spin_stabilised: float
    tumbling: float


class RollPitchYaw(Wire):
    """About x along the orbit (of `yaw_steering` across the other two), y against its normal, z to nadir."""

    roll: float
    pitch: float
    yaw: float


class AttitudeMode(Wire):
    """What holds the body, or that nothing does."""

    mode: Literal["inertially_fixed", "nadir_pointing", "yaw_steering", "sun_pointing", "spin_stabilised", "tumbling"]
    """The most probable."""
    probabilities: AttitudeModeProbabilities
    offset_deg: float | None
    """From the nearest attitude whose axes are the reference's; of `sun_pointing` from the Sun to the nearest axis."""
    sigma_deg: float | None
    offset_axes_deg: RollPitchYaw | None
    sigma_axes_deg: RollPitchYaw | None
    body_axis: Literal["+x", "+y", "+z", "-x", "-y", "-z"] | None
    """Of the mesh, that points to nadir, or to the Sun."""


class JointLawProbabilities(Wire):
    """All as likely before; they sum to 1."""

    still: float
    sun_tracking: float
    neither: float


class JointMotion(Wire):
    """Whether a hinge stood still over the pass, or kept its panel towards the Sun."""

    name: str
    law: Literal["still", "sun_tracking", "neither"]
    """The most probable."""
    probabilities: JointLawProbabilities
    value_deg: float | None
    """Of `still`: where it stood."""
    offset_deg: float | None
    """Of `sun_tracking`: by how much the joint is ahead of facing the Sun, as far as its range lets it."""
    sigma_deg: float | None


class MotionErrors(Wire):
    """How the frames err."""

    scale: float
    """By which their stated spreads had to be multiplied."""
    independent_frames: float
    """As many as if each erred by itself."""


class PassMotion(Wire):
    """How the object turned over the pass; sigmas are standard deviations. See docs/motion.md."""

    session_id: str
    model: Literal["constant_rate", "tumbling"]
    probabilities: MotionProbabilities
    relative_to: Literal["GCRF", "camera"]
    """`camera` where the camera's orientation is not known in every frame."""
    epoch: str
    """The middle of the frames used; all that changes is told of it."""
    span_s: float
    frames: MotionFrames
    probability: float
    """That the object took this course of orientations, whichever the model; where no frame is sure, it may be none."""
    angular_velocity_body_deg_s: Vector
    sigma_deg_s: Vector
    covariance_body_deg2_s2: list[list[float]]
    angular_velocity_gcrf_deg_s: Vector | None
    covariance_gcrf_deg2_s2: list[list[float]] | None
    rate_deg_s: float
    """About the axis that the motion keeps."""
    rate_sigma_deg_s: float
    period_s: float | None
    """Null where no turning is seen beyond three of its sigmas."""
    period_sigma_s: float | None
    axis_body: Vector
    axis_body_sigma_deg: float
    axis_gcrf: Vector | None
    """The axis that the motion keeps: of the rate, of a tumbling body of its angular momentum."""
    axis_gcrf_sigma_deg: float | None
    orientation: Orientation
    """Body -> GCRF, or body -> camera, at the epoch."""
    orientation_sigma_deg: float
    alternatives: list[MotionAlternative]
    """All courses with a probability of 0.001 or more, most probable first: this one among them."""
    attitude_mode: AttitudeMode | None
    """Null where the camera's orientation or the object's orbit is not known."""
    joints: list[JointMotion] = Field(default_factory=list)
    """Hinges that are estimated, where the attitude mode is known; none that the session was told to follow the Sun."""
    inertia: Inertia | None
    """Of `tumbling` only."""
    errors: MotionErrors
    warnings: list[str] = Field(default_factory=list)

"""Every choice a session can make, as data that is stored with it. One definition serves filter, API and docs."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, ClassVar, Literal

from service.inference.checks import FORBID, FieldError, require
from service.inference.scene import CameraParams, LightParams, PriorParams

__all__ = [
    "CameraParams",
    "FilterParams",
    "JointParams",
    "LightParams",
    "LikelihoodParams",
    "MotionParams",
    "PriorParams",
    "SessionConfig",
    "preset_defaults",
]


@dataclass(frozen=True)
class FilterParams:
    """The filter itself."""

    __pydantic_config__: ClassVar[dict[str, Any]] = FORBID

    preset: Literal["balanced", "paper"] = "balanced"
    """Where other defaults come from. `paper`: the published method (docs/method.md)."""
    method: Literal["auto", "mixture", "bootstrap"] = "auto"
    """`mixture` (`auto`): modes that explain the light itself, the Sun told or not (docs/model.md); it draws with
    OpenCL. `bootstrap`: resample, jitter, weigh, once a frame (the paper)."""
    particles: int = 1000
    """`bootstrap`: carried from frame to frame. `mixture`: drawn from it for every answer."""
    seed: int = 0
    """Same seed and same frames, same estimates."""
    resampler: Literal["multinomial", "systematic", "stratified", "residual"] = "systematic"
    """`bootstrap`; `multinomial` is the paper's Eq. 6."""
    backend: Literal["auto", "outline", "opengl", "cpu", "cpu-mt", "reference"] = "auto"
    """`bootstrap`: what sums the map under the silhouettes. `auto`: outlines on the fastest device, on the next one
    where a device fails. `outline`: the same on the first device, or not at all. `opengl`: drawn by OpenGL, summed by
    OpenCL (the paper's GPU row). `cpu`, `cpu-mt`: filled on one core, on all (its other rows). `reference`: NumPy,
    slow. All give the same sums, `opengl` but for pixels along the edge."""
    step: Literal["auto", "host", "device"] = "auto"
    """`bootstrap`: where particles are drawn, moved and scored. `device`: on the scorer's, with random numbers of its
    own (the same law, other draws than `host`; the first frame is the host's). `auto`: there where it pays, which is
    with 5,000 particles or more on a GPU whose scorer takes them (`auto`, `outline`); else `host`."""

    def __post_init__(self) -> None:
        require(1 <= self.particles <= 10_000_000, "particles must be between 1 and 10,000,000")
        require(0 <= self.seed < 2**63, "seed must be between 0 and 2^63 - 1")
        on_device = self.method == "bootstrap" and self.resampler in ("multinomial", "systematic")
        require(self.step != "device" or on_device, "step device is for bootstrap, multinomial or systematic")


@dataclass(frozen=True)
class LikelihoodParams:
    """`bootstrap`: from a frame to its log-ratio map (Eq. 3), p(D|b) an empirical histogram and p(D|f) uniform."""

    __pydantic_config__: ClassVar[dict[str, Any]] = FORBID

    feature: Literal["auto", "intensity", "colour", "gradient"] = "auto"
    """What is measured in each pixel; `auto` takes colour where the frames have it."""
    gradient_sigma_px: float = 1.0
    """Scale of the derivative image for `gradient`."""

    def __post_init__(self) -> None:
        require(0.1 <= self.gradient_sigma_px <= 50, "gradient_sigma_px must be between 0.1 and 50")


@dataclass(frozen=True)
class MotionParams:
    """How a pose may change between frames; standard deviations per square root of a second."""

    __pydantic_config__: ClassVar[dict[str, Any]] = FORBID

    kind: Literal["jitter", "constant_velocity"] = "constant_velocity"
    """`jitter`: a random step (the paper, and all that `bootstrap` knows). `constant_velocity`: each mode has rates."""
    rotation_deg: float = 2.5
    """Rotation, about each axis."""
    position: float = 0.05
    """Position, as a share of the image's shorter side."""
    log_scale: float = 0.016
    """Scale, as a relative change."""
    joint_deg: float = 3.0
    """Revolute joints."""
    joint_range: float = 0.02
    """Prismatic joints, as a share of their range."""
    rate_spread: float = 10.0
    """`constant_velocity`: standard deviation of a rate that nothing is known of, per second, as a multiple of the
    jitter above (10: 25 degrees per second)."""
    rate_change: float = 2.0
    """`constant_velocity`: by how much a rate may change within a second, as a multiple of the jitter above."""
    frame_interval_s: float = 0.1
    """Assumed between frames that bring no time."""

    def __post_init__(self) -> None:
        names = ("rotation_deg", "position", "log_scale", "joint_deg", "joint_range", "rate_spread", "rate_change")
        for name in (*names, "frame_interval_s"):
            require(0 < getattr(self, name) <= 1e4, f"{name} must lie in (0, 10000]")


@dataclass(frozen=True)
class JointParams:
    """Which joints are estimated."""

    __pydantic_config__: ClassVar[dict[str, Any]] = FORBID

    free: Literal["all"] | tuple[str, ...] = ()
    """Names of the joints to estimate, or `all`. The others stay at their initial value."""
    fixed: Mapping[str, float] = field(default_factory=dict)
    """Values of joints that are known: degrees (revolute) or model units (prismatic)."""
    sun_tracking: tuple[str, ...] = ()
    """Hinges among the free ones that turn panels towards the Sun, each as far as its axis lets it. Either side of a
    panel may be the one that faces it."""
    sun_tracking_sigma_deg: float = 10.0
    """Standard deviation of what is left between them."""

    def __post_init__(self) -> None:
        require(0.1 <= self.sun_tracking_sigma_deg <= 180, "sun_tracking_sigma_deg must lie in [0.1, 180]")


@dataclass(frozen=True)
class SessionConfig:
    """The effective configuration of a session."""

    __pydantic_config__: ClassVar[dict[str, Any]] = FORBID

    filter: FilterParams = field(default_factory=FilterParams)
    likelihood: LikelihoodParams = field(default_factory=LikelihoodParams)
    prior: PriorParams = field(default_factory=PriorParams)
    motion: MotionParams = field(default_factory=MotionParams)
    camera: CameraParams = field(default_factory=CameraParams)
    joints: JointParams = field(default_factory=JointParams)
    light: LightParams = field(default_factory=LightParams)

    def __post_init__(self) -> None:
        site = self.camera.site_latitude_deg
        affine = self.filter.method == "bootstrap"
        require(not affine or self.camera.perspective is None, "camera.perspective is not for bootstrap: it is affine")
        if self.prior.orbit is not None and site is None:
            raise FieldError("prior.orbit", "needs the site: camera.site_latitude_deg and camera.site_longitude_deg")
        if self.prior.attitude_mode is not None and self.prior.orbit is None:
            raise FieldError("prior.attitude_mode", "needs prior.orbit: the frame that holds the body moves along it")


# contract: the settings of the paper
_PAPER: Mapping[str, Mapping[str, Any]] = {
    "filter": {
        "preset": "paper",
        "method": "bootstrap",
        "particles": 3000,
        "resampler": "multinomial",
    },
    "motion": {"kind": "jitter", "rotation_deg": 6.0, "position": 0.03, "log_scale": 0.03, "joint_deg": 10.0},
}


def preset_defaults(preset: str) -> Mapping[str, Mapping[str, Any]]:
    """Nested plain defaults of a preset, to be overlaid by what a client sends. Raises ``ValueError``."""
    if preset == "paper":
        return _PAPER
    if preset == "balanced":
        return {}
    raise ValueError(f"unknown preset {preset!r}; there are balanced and paper")

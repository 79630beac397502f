"""Every choice a session can make, as data that is stored with it. One definition serves filter, API and docs."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, ClassVar, Literal

from service.inference.checks import FORBID, require
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
    """The particle filter itself."""

    __pydantic_config__: ClassVar[dict[str, Any]] = FORBID

    preset: Literal["balanced", "paper"] = "balanced"
    """Where every other default comes from. `paper` is the published method, nothing else."""
    method: Literal["auto", "mixture", "importance", "bootstrap"] = "auto"
    """`bootstrap`: resample, jitter, weigh, once a frame (the paper). `importance`: adapt a proposal to each mode, in
    steps of the likelihood's power, and draw the particles from it with their exact weights. `mixture`: modes that
    explain the light itself, the Sun told or not (docs/model.md). `auto`: `mixture` where OpenCL has a device;
    `importance` where it has none, in a session that compares models, and in one that names a `backend`."""
    particles: int = 1000
    """Particles carried from frame to frame."""
    seed: int = 0
    """Same seed and same frames, same estimates."""
    resampler: Literal["multinomial", "systematic", "stratified", "residual"] = "systematic"
    """`multinomial` is the paper's Eq. 6."""
    acquisition_particles: int = 6000
    """Rotations that are tried when nothing is known."""
    backend: Literal["auto", "outline", "opengl", "cpu", "cpu-mt", "reference"] = "auto"
    """What sums the map under the silhouettes. `auto`: outlines on the fastest device, on the next one where a device
    fails. `outline`: the same on the first device, or not at all. `opengl`: drawn by OpenGL, summed by OpenCL (the
    paper's GPU row). `cpu`, `cpu-mt`: filled on one core, on all (its other rows). `reference`: NumPy, slow. All give
    the same sums, `opengl` but for pixels along the edge."""
    prefer: Literal["likelihood", "weight", "continuity"] = "likelihood"
    """Which mode `best` is taken from: the one with the particle of highest likelihood of this frame, the heaviest, or
    the one nearest to where the last `best` should be by its rates. No mode is dropped for it. Not for `bootstrap`."""
    step: Literal["auto", "host", "device"] = "auto"
    """`bootstrap`: where particles are drawn, moved and scored. `device`: on the scorer's, with random numbers of its
    own (the same law, other draws than `host`; the first frame is the host's). `auto`: there where it pays, which is
    with 5,000 particles or more on a GPU whose scorer takes them (`auto`, `outline`); else `host`."""
    adaptive: Literal["off", "ess", "kld"] = "off"
    """Whether a frame of an established track takes fewer: as many as make `enough_ess` effective ones (`ess`), or as
    the bins that the posterior fills ask for (`kld`, Fox 2001). Not for steps on the device. `balanced`: `ess`."""
    least_particles: int = 100
    """`adaptive` takes no fewer."""
    enough_ess: float = 100.0
    """What `adaptive` `ess` aims at."""

    def __post_init__(self) -> None:
        require(1 <= self.particles <= 10_000_000, "particles must be between 1 and 10,000,000")
        require(0 <= self.seed < 2**63, "seed must be between 0 and 2^63 - 1")
        on_device = self.method == "bootstrap" and self.resampler in ("multinomial", "systematic")
        require(self.step != "device" or on_device, "step device is for bootstrap, multinomial or systematic")
        require(1 <= self.least_particles <= 10_000_000, "least_particles must be between 1 and 10,000,000")
        require(1 <= self.enough_ess <= 1e7, "enough_ess must be between 1 and 10,000,000")
        require(
            1 <= self.acquisition_particles <= 10_000_000,
            "acquisition_particles must be between 1 and 10,000,000",
        )


@dataclass(frozen=True)
class LikelihoodParams:
    """From a frame to its log-ratio map (Eq. 3)."""

    __pydantic_config__: ClassVar[dict[str, Any]] = FORBID

    kind: Literal["contrast", "histogram"] = "contrast"
    """`histogram`: p(D|b) an empirical histogram, p(D|f) uniform (the paper). `contrast`: the edge is where the
    object's light falls to half of its local brightness, which a blur does not move."""
    feature: Literal["auto", "intensity", "colour", "gradient"] = "auto"
    """`histogram`, and Eq. 2's constant in both: what is measured in each pixel; `auto` takes colour where the frames
    have it. The `contrast` map is of all channels."""
    gradient_sigma_px: float = 1.0
    """Scale of the derivative image for `gradient`."""
    exponent: float = 0.05
    """Power of the likelihood of a perfect fit: neighbouring pixels are not independent. 1 is the paper's product over
    pixels."""
    misfit_nats: float = 4.3
    """The power falls with what the best silhouette leaves unexplained, lately: to one half where that is so much per
    pixel of the object's radius. Not for `bootstrap`."""
    mode_exponent: float = 0.05
    """`importance`: power of the likelihood from one mode to another, and from one model to another. Nearby poses share
    what the map gets wrong about shadow and glare; far ones do not, and no frame alone may decide between them."""
    covered_empty_nats: float = 0.5
    """`contrast`: price of one pixel of background under the silhouette."""
    uncovered_bright_nats: float = 3.0
    """`contrast`: price of one pixel of light left outside of the silhouette."""
    edge_nats_per_px: float = 0.6
    """`contrast`: while tracking that price begins at `covered_empty_nats` and rises so fast from the edge of the light
    inwards. With two different prices at the edge itself the silhouette that fits best is too large."""
    shading_nats: float = 800.0
    """`contrast`: while searching, what it is worth, before `mode_exponent`, if a sunlit body leaves e times less of
    the brightness over. 0: outlines alone."""
    shading_power: float = 8.0
    """`contrast`, `importance`: power of the likelihood of light and shade, from one pose to another near it, as a
    multiple of `exponent`'s. 0: outlines alone."""

    def __post_init__(self) -> None:
        require(0 <= self.shading_nats <= 1e6, "shading_nats must lie in [0, 1000000]")
        require(0 <= self.shading_power <= 1000, "shading_power must lie in [0, 1000]")
        require(0.1 <= self.gradient_sigma_px <= 50, "gradient_sigma_px must be between 0.1 and 50")
        require(0 < self.exponent <= 1, "exponent must lie in (0, 1]")
        require(1e-3 <= self.misfit_nats <= 1e9, "misfit_nats must be between 0.001 and 1e9")
        require(0 < self.mode_exponent <= 1, "mode_exponent must lie in (0, 1]")
        require(0 < self.covered_empty_nats <= 100, "covered_empty_nats must lie in (0, 100]")
        require(1e-3 <= self.edge_nats_per_px <= 1e9, "edge_nats_per_px must be between 0.001 and 1e9")
        require(0 < self.uncovered_bright_nats <= 100, "uncovered_bright_nats must lie in (0, 100]")


@dataclass(frozen=True)
class MotionParams:
    """How a pose may change between frames; standard deviations per square root of a second."""

    __pydantic_config__: ClassVar[dict[str, Any]] = FORBID

    kind: Literal["jitter", "constant_velocity"] = "constant_velocity"
    """`jitter`: a random step (the paper). `constant_velocity`: each particle carries the rates that its own path
    implies."""
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
        require(self.prior.orbit is None or site is not None, "prior.orbit needs the site, camera.site_latitude_deg …")


_PAPER: Mapping[str, Mapping[str, Any]] = {
    "filter": {
        "preset": "paper",
        "method": "bootstrap",
        "particles": 3000,
        "resampler": "multinomial",
    },
    "likelihood": {"kind": "histogram", "exponent": 1.0},
    "motion": {"kind": "jitter", "rotation_deg": 6.0, "position": 0.03, "log_scale": 0.03, "joint_deg": 10.0},
}
_BALANCED: Mapping[str, Mapping[str, Any]] = {"filter": {"adaptive": "ess"}}


def preset_defaults(preset: str) -> Mapping[str, Mapping[str, Any]]:
    """Nested plain defaults of a preset, to be overlaid by what a client sends. Raises ``ValueError``."""
    if preset == "paper":
        return _PAPER
    if preset == "balanced":
        return _BALANCED
    raise ValueError(f"unknown preset {preset!r}; there are balanced and paper")

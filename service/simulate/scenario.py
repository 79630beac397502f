"""A simulated pass as data: presets by name, and passes drawn at random for benchmarks."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from service.simulate.atmosphere import Air
from service.simulate.camera import Camera
from service.simulate.materials import Materials
from service.simulate.motion import Motion
from service.simulate.overflight import Overflight
from service.simulate.render import Light


@dataclass(frozen=True)
class Scenario:
    """Everything that decides a pass. The same scenario and mesh give the same images, bit for bit."""

    note: str
    """What the pass tests."""
    size: tuple[int, int] = (256, 256)
    """Width and height of the images."""
    seed: int = 0
    """Seed of all random numbers."""
    telescope: int = 0
    """Of several that see the same pass: air, stars and noise are each one's own."""
    background_frames: int = 10
    """Images of empty sky before the pass."""
    motion: Motion = field(default_factory=Motion)
    """How the body moves."""
    light: Light = field(default_factory=Light)
    """The sun and the Earth."""
    materials: Materials = "painted"
    """What the body is made of: ``painted``, or ``mixed`` as real spacecraft are."""
    path_traced: bool = False
    """Drawn by a path tracer (``path_tracing``) instead of facet by facet."""
    mesh_error: float = 0.0
    """How far the body is from its mesh: standard deviation of the log of its pieces' sizes (``wrong_mesh``)."""
    overflight: Overflight | None = None
    """A real satellite over a real place: then Sun, Earth, scale and the camera's turning are theirs."""
    air: Air = field(default_factory=Air)
    """Seeing."""
    camera: Camera = field(default_factory=Camera)
    """Sensor and sky."""


def night() -> Scenario:
    """8 bits, calm air, the sun behind the telescope."""
    return Scenario("8-bit, calm air, sun behind the telescope", camera=Camera(stars=12))


def day() -> Scenario:
    """Colour against a blue sky, a shaky mount."""
    return Scenario(
        "RGB against a blue sky, shaky mount",
        size=(320, 240),
        motion=Motion(frames=60, wobble_px=2.5, wobble_time_s=0.2, scale_drift_per_s=0.04, extent=0.6),
        light=Light(phase_deg=55.0, ambient=0.08),
        air=Air(psf_sigma_px=1.1, shake_px=0.3),
        camera=Camera(
            colour=True,
            signal_e=1500.0,
            sky_e=(500.0, 700.0, 1050.0),
            sky_gradient=0.25,
            airlight=0.15,
            read_noise_e=12.0,
            electrons_per_count=11.0,
            bias_counts=6.0,
        ),
    )


def seeing() -> Scenario:
    """Turbulence: speckle, warping, scintillation, image motion."""
    return Scenario(
        "turbulence: speckle, warping, scintillation",
        motion=Motion(extent=0.62, wobble_px=0.8),
        air=Air(psf_sigma_px=0.8, d_over_r0=3.0, warp_px=0.8, scintillation=0.12),
    )


def phase90() -> Scenario:
    """16 bits, half of the body in shadow."""
    return Scenario(
        "16-bit, half of the body in shadow",
        motion=Motion(extent=0.6),
        light=Light(phase_deg=90.0, sun_roll_deg=20.0, ambient=0.015),
        camera=_deep_camera(),
    )


def panel() -> Scenario:
    """16 bits, moving joints."""
    return Scenario("16-bit, moving joints", motion=Motion(frames=50), light=Light(ambient=0.03), camera=_deep_camera())


def small() -> Scenario:
    """Small in the image."""
    return Scenario("small in the image", motion=Motion(extent=0.28), camera=Camera(stars=10))


def outage() -> Scenario:
    """Eight blank frames in the middle."""
    return Scenario(
        "eight blank frames in the middle",
        motion=Motion(frames=50, outage=(20, 8)),
        camera=Camera(stars=10),
    )


def demo() -> Scenario:
    """The pass of ``skypose demo``: tumbling, a turning wing, moderate seeing."""
    return Scenario(
        "the bundled satellite: tumbling, one turning wing, moderate seeing",
        motion=Motion(frames=60, extent=0.8, rate_deg_s=5.0, joint_rate_deg_s=8.0, scale_drift_per_s=0.01),
        light=Light(phase_deg=30.0, ambient=0.06),
        air=Air(psf_sigma_px=1.0, shake_px=0.3, scintillation=0.04),
        camera=Camera(stars=15, signal_e=600.0),
    )


PRESETS: Mapping[str, Callable[[], Scenario]] = {
    "night": night,
    "day": day,
    "seeing": seeing,
    "phase90": phase90,
    "panel": panel,
    "small": small,
    "outage": outage,
    "demo": demo,
}


def randomised(seed: int, *, size: tuple[int, int] = (256, 256), frames: int = 40) -> Scenario:
    """A pass with attitude, rates, light, seeing, signal and size drawn at random, for statistics."""
    rng = np.random.default_rng([seed, 0x706173])
    d_over_r0 = float(rng.choice([0.0, rng.uniform(1.0, 5.0)]))
    deep = bool(rng.integers(2))
    base = _deep_camera() if deep else Camera()
    return Scenario(
        f"random pass {seed}",
        size=size,
        seed=seed,
        motion=Motion(
            frames=frames,
            extent=float(rng.uniform(0.3, 0.8)),
            rate_deg_s=float(rng.uniform(0.0, 15.0)),
            scale_drift_per_s=float(rng.uniform(-0.03, 0.03)),
            position_share=(float(rng.uniform(0.42, 0.58)), float(rng.uniform(0.42, 0.58))),
            wobble_px=float(rng.uniform(0.2, 2.0)),
            joint_rate_deg_s=float(rng.uniform(0.0, 20.0)),
        ),
        light=Light(
            phase_deg=float(rng.uniform(0.0, 100.0)),
            sun_roll_deg=float(rng.uniform(0.0, 360.0)),
            ambient=float(rng.uniform(0.01, 0.08)),
        ),
        air=Air(
            psf_sigma_px=float(rng.uniform(0.7, 1.8)),
            d_over_r0=d_over_r0,
            warp_px=float(rng.uniform(0.0, 1.0)) if d_over_r0 else 0.0,
            scintillation=float(rng.uniform(0.0, 0.2)),
        ),
        camera=replace(base, signal_e=base.signal_e * float(np.exp(rng.uniform(-1.2, 0.7))), stars=10),
    )


def _deep_camera() -> Camera:
    """A 16-bit sensor of low noise; dim objects are a few hundred counts above a bias of some hundred."""
    return Camera(
        bits=16,
        signal_e=2600.0,
        sky_e=(30.0, 30.0, 30.0),
        read_noise_e=11.0,
        electrons_per_count=2.0,
        bias_counts=325.0,
        stars=12,
        star_e=2500.0,
    )

"""Passes drawn at random as real frames are: mixed materials, earthshine, phase angles to 110 degrees, some by day.

Chances and ranges are those of path-traced passes that a benchmark of this project is made of (docs/benchmarks.md).
"""

from __future__ import annotations

import numpy as np

from service.simulate.atmosphere import Air
from service.simulate.camera import Camera
from service.simulate.motion import Motion
from service.simulate.render import Light
from service.simulate.scenario import Scenario

SIZE = (192, 192)
FRAMES = 14
_DIAMETER_SHARE = (45 / 192, 150 / 192)  # of the bounding sphere, over the image's shorter side
_SPIN_DEG = (0.1, 2.0)  # a frame
_JOINT_DEG = (0.1, 0.35)  # a frame
_SIGNAL_E = (500.0, 4000.0)
_CHANCE_8_BITS, _CHANCE_16_BITS, _CHANCE_DAY = 0.46, 0.46, 0.08
_CHANCE_TURBULENT = 0.25
_CHANCE_JOINTS_MOVE = 0.6
_SEEDS = 0x6D697865


def randomised_mixed(seed: int, *, size: tuple[int, int] = SIZE, frames: int = FRAMES) -> Scenario:
    """A pass with attitude, rates, light, materials, seeing, sensor and size drawn at random."""
    rng = np.random.default_rng([seed, _SEEDS])
    camera = _camera(rng)
    turbulent = not camera.colour and rng.uniform() < _CHANCE_TURBULENT
    light, air, motion = _light(rng), _air(rng, turbulent), _motion(rng, frames, turbulent)
    seen = f"D/r0 {air.d_over_r0:.1f}" if turbulent else "calm"
    return Scenario(
        f"random mixed pass {seed}: phase {light.phase_deg:.0f} deg, {seen}, {motion.extent * min(size):.0f} px",
        size=size,
        seed=seed,
        background_frames=6,
        motion=motion,
        light=light,
        materials="mixed",
        air=air,
        camera=camera,
    )


def _camera(rng: np.random.Generator) -> Camera:
    kind = rng.choice(3, p=(_CHANCE_8_BITS, _CHANCE_16_BITS, _CHANCE_DAY))
    signal = _log_uniform(rng, *_SIGNAL_E)
    if kind == 0:
        return Camera(
            signal_e=signal,
            sky_e=(40.0, 40.0, 40.0),
            sky_gradient=0.2,
            read_noise_e=8.0,
            electrons_per_count=6.0,
            bias_counts=8.0,
            stars=30,
            star_e=600.0,
        )
    if kind == 1:
        return Camera(
            bits=16,
            signal_e=signal,
            sky_e=(60.0, 60.0, 60.0),
            sky_gradient=0.1,
            read_noise_e=6.0,
            electrons_per_count=1.5,
            bias_counts=300.0,
            stars=30,
            star_e=1000.0,
        )
    return Camera(
        colour=True,
        signal_e=signal,
        sky_e=(385.0, 560.0, 875.0),
        sky_gradient=0.25,
        cloud=0.03,
        airlight=0.15,
        read_noise_e=12.0,
        electrons_per_count=10.0,
        bias_counts=4.0,
    )


def _light(rng: np.random.Generator) -> Light:
    earth = rng.standard_normal(3)
    x, y, z = (float(value) for value in earth / np.linalg.norm(earth))
    return Light(
        phase_deg=float(rng.triangular(0.0, 20.0, 110.0)),
        sun_roll_deg=float(rng.uniform(0.0, 360.0)),
        ambient=0.0,
        earth=float(rng.uniform(0.02, 0.12)),
        towards_earth=(x, y, z),
    )


def _air(rng: np.random.Generator, turbulent: bool) -> Air:
    sigma, d_over_r0 = float(rng.uniform(0.5, 1.05)), float(rng.uniform(1.0, 6.0))
    if not turbulent:
        return Air(psf_sigma_px=sigma, scintillation=0.03)
    return Air(psf_sigma_px=0.5, d_over_r0=d_over_r0, airy_px=1.6, warp_px=0.12 * d_over_r0, scintillation=0.06)


def _motion(rng: np.random.Generator, frames: int, turbulent: bool) -> Motion:
    interval_s = Motion.frame_interval_s
    return Motion(
        frames=frames,
        extent=float(rng.uniform(*_DIAMETER_SHARE)),
        rate_deg_s=_log_uniform(rng, *_SPIN_DEG) / interval_s,
        position_share=(float(rng.uniform(0.42, 0.58)), float(rng.uniform(0.42, 0.58))),
        wobble_px=1.0 if turbulent else 0.5,
        joint_start_deg=float(rng.uniform(-60.0, 60.0)),
        joint_rate_deg_s=float(rng.choice([-1.0, 1.0]) * rng.uniform(*_JOINT_DEG)) / interval_s,
        joints=None if rng.uniform() < _CHANCE_JOINTS_MOVE else (),
    )


def _log_uniform(rng: np.random.Generator, low: float, high: float) -> float:
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))

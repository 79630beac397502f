"""Passes drawn at random as real frames are: mixed materials, earthshine, phase angles to 110 degrees, some by day.

Chances and ranges are those of path-traced passes that a benchmark of this project is made of (docs/benchmarks.md).
What decides how hard a pass is comes from an additive recurrence (steps of irrational lengths): passes of neighbouring
seeds cover the ranges evenly, so that a benchmark of some twenty does not hang on the luck of the draw.
"""

from __future__ import annotations

from typing import NamedTuple

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
_CHANCE_8_BITS, _CHANCE_DAY = 0.46, 0.08  # else 16 bits; by day the air is calm
_CHANCE_TURBULENT = 0.25
_CHANCE_JOINTS_MOVE = 0.6
_MOST_PHASE_DEG, _PHASE_POWER = 110.0, 1.5  # the power makes small ones likelier
_STAR_RATE_PX_S = (-45.0, 25.0)
_SEEDS = 0x6D697865
_STEPS = np.sqrt([2.0, 3.0, 5.0, 7.0, 11.0, 13.0, 17.0, 19.0])


class _Even(NamedTuple):
    """Numbers from 0 to 1, each of them spread evenly over neighbouring seeds."""

    sensor: float
    air: float
    signal: float
    phase: float
    diameter: float
    seeing: float
    spin: float
    joints: float


def randomised_mixed(seed: int, *, size: tuple[int, int] = SIZE, frames: int = FRAMES) -> Scenario:
    """A pass with attitude, rates, light, materials, seeing, sensor and size drawn at random."""
    rng = np.random.default_rng([seed, _SEEDS])
    even = _Even(*((0.5 + seed * _STEPS) % 1.0).tolist())
    turbulent = even.air < _CHANCE_TURBULENT
    camera = _camera(even, turbulent)
    light, air, motion = _light(rng, even), _air(even, turbulent), _motion(rng, even, frames, turbulent)
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


def _camera(even: _Even, turbulent: bool) -> Camera:
    signal = _log_between(even.signal, *_SIGNAL_E)
    if even.sensor < _CHANCE_8_BITS:
        return Camera(
            signal_e=signal,
            sky_e=(40.0, 40.0, 40.0),
            sky_gradient=0.2,
            read_noise_e=8.0,
            electrons_per_count=6.0,
            bias_counts=8.0,
            stars=30,
            star_e=1500.0,
            star_rate_px_s=_STAR_RATE_PX_S,
        )
    if even.sensor < 1.0 - _CHANCE_DAY or turbulent:
        return Camera(
            bits=16,
            signal_e=signal,
            sky_e=(60.0, 60.0, 60.0),
            sky_gradient=0.1,
            read_noise_e=6.0,
            electrons_per_count=1.5,
            bias_counts=300.0,
            stars=30,
            star_e=2500.0,
            star_rate_px_s=_STAR_RATE_PX_S,
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


def _light(rng: np.random.Generator, even: _Even) -> Light:
    earth = rng.standard_normal(3)
    x, y, z = (float(value) for value in earth / np.linalg.norm(earth))
    return Light(
        phase_deg=_MOST_PHASE_DEG * even.phase**_PHASE_POWER,
        sun_roll_deg=float(rng.uniform(0.0, 360.0)),
        ambient=0.0,
        earth=float(rng.uniform(0.02, 0.12)),
        towards_earth=(x, y, z),
    )


def _air(even: _Even, turbulent: bool) -> Air:
    if not turbulent:
        return Air(psf_sigma_px=_between(even.seeing, 0.5, 1.05), scintillation=0.03)
    d_over_r0 = _between(even.seeing, 1.0, 6.0)
    return Air(psf_sigma_px=0.5, d_over_r0=d_over_r0, airy_px=1.6, warp_px=0.12 * d_over_r0, scintillation=0.06)


def _motion(rng: np.random.Generator, even: _Even, frames: int, turbulent: bool) -> Motion:
    interval_s = Motion.frame_interval_s
    return Motion(
        frames=frames,
        extent=_between(even.diameter, *_DIAMETER_SHARE),
        rate_deg_s=_log_between(even.spin, *_SPIN_DEG) / interval_s,
        position_share=(float(rng.uniform(0.42, 0.58)), float(rng.uniform(0.42, 0.58))),
        wobble_px=1.0 if turbulent else 0.5,
        joint_start_deg=float(rng.uniform(-60.0, 60.0)),
        joint_rate_deg_s=float(rng.choice([-1.0, 1.0]) * rng.uniform(*_JOINT_DEG)) / interval_s,
        joints=None if even.joints < _CHANCE_JOINTS_MOVE else (),
    )


def _between(share: float, low: float, high: float) -> float:
    return low + share * (high - low)


def _log_between(share: float, low: float, high: float) -> float:
    return float(low * (high / low) ** share)

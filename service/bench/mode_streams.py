"""Passes in the attitude modes that operators use, as streams of what frames say, over drawn orbits."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from service.bench.motion_bench import RATE_SIGMA
from service.bench.motion_streams import StreamPlan, draw_motion, seen_stream
from service.bench.told_laws import line_of, told_document
from service.inference.pose import exp_so3, from_matrices, multiply
from service.inference.spin.alignment import ALIGNMENTS, OFFSET_SIGMA
from service.inference.spin.attitude_modes import attitude_modes
from service.inference.spin.basins import MODES
from service.inference.spin.fit import fit_pass
from service.inference.spin.held_frames import nadir_frames, sun_frames, yaw_steering_frames
from service.inference.spin.rigid_body import orientations
from service.inference.state import Array

_EARTH_KM, _MU = 6378.137, 398_600.4418  # km^3/s^2
_HEIGHTS_KM = (420.0, 550.0, 700.0, 820.0, 1336.0)  # of the station, of internet, Earth and altimetry satellites
_LEAST_ELEVATION_DEG = 20.0
_SPANS_S = (60.0, 300.0)  # of a pass, log-uniform; no longer than it stands above that elevation
_SPINS = StreamPlan(rates_deg_s=(0.3, 10.0))
_TUMBLES = StreamPlan(rates_deg_s=(0.5, 5.0), least_nutation_deg=10.0)


@dataclass(frozen=True)
class ModeRow:
    """One pass."""

    truth: str
    told: str
    probability: float  # of what is told
    probability_of_truth: float
    height_km: float
    span_s: float
    sigma_deg: float
    seconds: float


def run_modes(passes: int, frames: int, seed: int, tell: Callable[[ModeRow], None]) -> list[ModeRow]:
    """``passes`` over the modes in turn."""
    rows = []
    for number in range(passes):
        rng = np.random.default_rng([seed, number])
        rows.append(_one(rng, MODES[number % len(MODES)], frames))
        tell(rows[-1])
    return rows


def _one(rng: np.random.Generator, mode: str, frames: int) -> ModeRow:
    height = float(rng.choice(_HEIGHTS_KM))
    span = min(float(np.exp(rng.uniform(*np.log(_SPANS_S)))), above_s(height, _LEAST_ELEVATION_DEG))
    times = np.linspace(0.0, span, frames)
    references = draw_references(rng, times, height)
    one = seen_stream(rng, times, draw_orientations(rng, mode, times, references))
    began = time.perf_counter()
    found = fit_pass(one.frames, RATE_SIGMA)
    said = attitude_modes(one.frames, references, found)
    seconds = time.perf_counter() - began
    told, p = said.best, said.probabilities
    return ModeRow(mode, told, p[told], p[mode], height, span, one.sigma_deg, seconds)


def above_s(height_km: float, elevation_deg: float) -> float:
    """Seconds that a circular orbit's overhead pass stands above an elevation; the Earth's turning is left out."""
    elevation, radius = np.deg2rad(elevation_deg), _EARTH_KM + height_km
    half = np.arccos(_EARTH_KM / radius * np.cos(elevation)) - elevation
    return float(2 * half / np.sqrt(_MU / radius**3))


def draw_references(
    rng: np.random.Generator, times: Array, height_km: float, towards_sun: Array | None = None
) -> dict[str, Array]:
    """(n, 4) of the frames that bodies are held in, on a circular orbit. ``towards_sun``: GCRF; None: anywhere."""
    radius = _EARTH_KM + height_km
    plane = np.linalg.qr(rng.standard_normal((3, 3)))[0]
    phase = np.sqrt(_MU / radius**3) * times + rng.uniform(0, 2 * np.pi)
    place = np.cos(phase)[:, None] * plane[0] + np.sin(phase)[:, None] * plane[1]
    velocity = -np.sin(phase)[:, None] * plane[0] + np.cos(phase)[:, None] * plane[1]
    sun = np.broadcast_to(rng.standard_normal(3) if towards_sun is None else towards_sun, place.shape)
    return {
        "nadir_pointing": from_matrices(nadir_frames(place, velocity)),
        "yaw_steering": from_matrices(yaw_steering_frames(place, sun)),
        "sun_pointing": from_matrices(sun_frames(sun)),
    }


def draw_orientations(rng: np.random.Generator, mode: str, times: Array, references: Mapping[str, Array]) -> Array:
    """(n, 4) body -> GCRF of a body in this mode."""
    middle = times - 0.5 * times[-1]
    if mode in ("spin_stabilised", "tumbling"):
        tumbling = mode == "tumbling"
        plan = _TUMBLES if tumbling else _SPINS
        return np.asarray(orientations(draw_motion(rng, plan, tumbling=tumbling), middle)[0])
    start = rng.standard_normal(4)
    start /= np.linalg.norm(start)
    if mode == "inertially_fixed":
        return np.tile(start, (len(times), 1))
    off = exp_so3(OFFSET_SIGMA * rng.standard_normal(3))
    if mode == "sun_pointing":
        off = multiply(off, exp_so3(np.array([0.0, 0.0, rng.uniform(0, 2 * np.pi)])))
    held = multiply(off, ALIGNMENTS[int(rng.integers(len(ALIGNMENTS)))])
    return np.asarray(multiply(references[mode], held))


def mode_document(machine: Mapping[str, Any], rows: Sequence[ModeRow]) -> dict[str, Any]:
    """The JSON: rows, and for each mode how often it was told; then all of them, with their reliability."""
    by_mode = {name: [row for row in rows if row.truth == name] for name in MODES}
    lines = [line_of("mode", name, mine) for name, mine in by_mode.items() if mine]
    return told_document(machine, rows, [*lines, line_of("mode", "all", rows)])

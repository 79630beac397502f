"""The motion of a pass as the API answers it (docs/motion.md)."""

from __future__ import annotations

from collections.abc import Mapping
from datetime import datetime
from typing import Any

import numpy as np

from service.inference.spin import basins
from service.inference.spin.alignment import offset, tilt
from service.inference.spin.basins import AttitudeModes, Basin, JointLaw, PassMotion, Told, told
from service.inference.spin.rigid_body import inertia
from service.inference.state import Array
from service.sessions.absolute import named
from service.sessions.frame import format_time

_SEEN_SIGMAS = 3.0  # a rate that is less is told without a period
_LEAST_TOLD = 0.001  # probability of a course that is listed
DECIDED = 0.9  # probability from which one course is told as the answer
_MOST_EXPLAINED = 0.5  # share of the frames that a motion should explain
_POINTED = ("nadir_pointing", "yaw_steering", "sun_pointing")
_AXES = ("+x", "+y", "+z", "-x", "-y", "-z")


def motion_document(
    session_id: str, found: PassMotion, stored: int, epoch: datetime, *, absolute: bool, among: float = 1.0
) -> Mapping[str, Any]:
    """``epoch``: of the reference time; ``absolute``: rotations are against GCRF, else against the camera.

    ``among``: probability that the truth is among the modes of the frames at all.
    """
    lead = found.best_of(found.model)
    courses = found.courses()
    return {
        "session_id": session_id,
        "model": found.model,
        "probabilities": {name: found.probability_of(name) for name in ("constant_rate", "tumbling")},
        "relative_to": "GCRF" if absolute else "camera",
        "epoch": format_time(epoch),
        "span_s": 2 * found.half_span_s,
        "frames": {"stored": stored, "used": found.n_frames, "explained": lead.explained},
        **_turning(lead, absolute),
        "probability": among * _probability(courses, lead, found),
        "alternatives": [
            {"probability": min(p, 1.0), "model": basin.model, **_short(basin, absolute)}
            for p, basin in courses
            if p >= _LEAST_TOLD
        ],
        "attitude_mode": None if found.attitude is None else _attitude_mode(found.attitude),
        "joints": [_joint(one) for one in found.joints],
        "inertia": _inertia(lead) if found.model == "tumbling" else None,
        "errors": {"scale": lead.scale, "independent_frames": lead.independent},
        "warnings": _warnings(found, lead, courses, absolute, among),
    }


def _turning(lead: Basin, absolute: bool) -> dict[str, Any]:
    """The answer proper, of the most probable motion."""
    body, fixed, rate = told(lead, basins.rate_body), told(lead, basins.rate_fixed), told(lead, basins.turning_rate)
    axis, kept = told(lead, basins.axis_body), told(lead, basins.axis_fixed)
    period, period_sigma = _period(rate)
    degrees = float(np.rad2deg(1.0))
    return {
        "angular_velocity_body_deg_s": _axes(body.value * degrees),
        "sigma_deg_s": _axes(body.sigma * degrees),
        "covariance_body_deg2_s2": (body.covariance * degrees**2).tolist(),
        "angular_velocity_gcrf_deg_s": _axes(fixed.value * degrees) if absolute else None,
        "covariance_gcrf_deg2_s2": (fixed.covariance * degrees**2).tolist() if absolute else None,
        "rate_deg_s": float(rate.value[0]) * degrees,
        "rate_sigma_deg_s": float(rate.sigma[0]) * degrees,
        "period_s": period,
        "period_sigma_s": period_sigma,
        "axis_body": _axes(axis.value),
        "axis_body_sigma_deg": _across_deg(axis),
        "axis_gcrf": _axes(kept.value) if absolute else None,
        "axis_gcrf_sigma_deg": _across_deg(kept) if absolute else None,
        "orientation": named(_upper(lead.motion.quaternion[0])),
        "orientation_sigma_deg": float(np.sqrt(np.trace(lead.covariance[:3, :3]))) * degrees,
    }


def _short(basin: Basin, absolute: bool) -> dict[str, Any]:
    """One course of several."""
    body, rate, kept = told(basin, basins.rate_body), told(basin, basins.turning_rate), told(basin, basins.axis_fixed)
    degrees = float(np.rad2deg(1.0))
    return {
        "angular_velocity_body_deg_s": _axes(body.value * degrees),
        "sigma_deg_s": _axes(body.sigma * degrees),
        "period_s": _period(rate)[0],
        "axis_gcrf": _axes(kept.value) if absolute else None,
        "orientation": named(_upper(basin.motion.quaternion[0])),
    }


def _inertia(lead: Basin) -> dict[str, Any]:
    """Moments of a body that tumbles: their ratios and axes, and how far it nods."""
    ratios, nods = told(lead, basins.inertia_ratios), told(lead, basins.nutation)
    _, vectors = np.linalg.eigh(inertia(lead.motion.shape[0]))
    return {
        "ratios": ratios.value.tolist(),
        "ratios_sigma": ratios.sigma.tolist(),
        "axes_body": vectors.T.tolist(),
        "masses": lead.bodies,
        "nutation_deg": float(np.rad2deg(nods.value[0])),
        "nutation_sigma_deg": float(np.rad2deg(nods.sigma[0])),
    }


def _attitude_mode(found: AttitudeModes) -> dict[str, Any]:
    """The most probable mode, and how far from it a body that is held stands."""
    best = found.best
    answer = {
        "mode": best,
        "probabilities": dict(found.probabilities),
        "offset_deg": None,
        "sigma_deg": None,
        "offset_axes_deg": None,
        "sigma_axes_deg": None,
        "body_axis": None,
    }
    if best not in _POINTED:
        return answer
    basin = found.held[best]
    q, spread = basin.motion.quaternion[0], np.rad2deg(np.sqrt(np.diag(basin.covariance)[:3]))
    if best == "sun_pointing":
        angle, axis = tilt(q)
        size, sigma = float(np.rad2deg(angle)), float(np.sqrt(0.5 * np.sum(spread[:2] ** 2)))
        return {**answer, "offset_deg": size, "sigma_deg": sigma, "body_axis": _AXES[axis]}
    turn, aligned = offset(q)
    size = float(np.rad2deg(np.linalg.norm(turn)))
    along = turn / max(float(np.linalg.norm(turn)), 1e-9)
    sigma = float(np.rad2deg(np.sqrt(along @ basin.covariance[:3, :3] @ along)))
    names = ("roll", "pitch", "yaw")
    return {
        **answer,
        "offset_deg": size,
        "sigma_deg": sigma,
        "offset_axes_deg": dict(zip(names, np.rad2deg(turn).tolist(), strict=True)),
        "sigma_axes_deg": dict(zip(names, spread.tolist(), strict=True)),
        "body_axis": _AXES[tilt(aligned)[1]],
    }


def _joint(found: JointLaw) -> dict[str, Any]:
    """The most probable law of a joint, and its constant."""
    value, sigma = found.constants.get(found.best, (None, None))
    return {
        "name": found.name,
        "law": found.best,
        "probabilities": dict(found.probabilities),
        "value_deg": value if found.best == "still" else None,
        "offset_deg": value if found.best == "sun_tracking" else None,
        "sigma_deg": sigma,
    }


def _probability(courses: list[tuple[float, Basin]], lead: Basin, found: PassMotion) -> float:
    """Of the course that the answer is of, whichever law it follows."""
    same = (p for p, one in courses if found.same(one, lead))
    return float(min(sum(same), 1.0))


def _warnings(
    found: PassMotion, lead: Basin, courses: list[tuple[float, Basin]], absolute: bool, among: float
) -> list[str]:
    out = []
    if among < DECIDED:
        out.append("in no frame is it sure that the model explains what is seen: the truth may be none of the courses")
    if not absolute:
        out.append("the camera's orientation is not known in every frame: rates and axes are against the camera")
    elif found.attitude is None:
        out.append("the attitude mode is not known: it needs the object's orbit, prior.orbit")
    if _probability(courses, lead, found) < DECIDED:
        out.append("several motions explain these frames: see alternatives")
    if lead.explained < _MOST_EXPLAINED:
        out.append("less than half of the frames are explained: no motion of a free or steadily turning body fits")
    if _period(told(lead, basins.turning_rate))[0] is None:
        out.append("no turning is seen beyond its spread: no period")
    return out


def _period(rate: Told) -> tuple[float | None, float | None]:
    """2 pi / w with its standard deviation, where w is seen."""
    w, sigma = float(rate.value[0]), float(rate.sigma[0])
    if w < _SEEN_SIGMAS * sigma or w <= 0.0:
        return None, None
    return 2 * np.pi / w, 2 * np.pi * sigma / w**2


def _across_deg(axis: Told) -> float:
    """Root mean square angle off, at most that of an axis that may be any."""
    return float(np.rad2deg(min(np.sqrt(np.trace(axis.covariance)), np.pi / 2)))


def _axes(vector: Array) -> dict[str, float]:
    return dict(zip("xyz", vector.tolist(), strict=True))


def _upper(quaternion: Array) -> Array:
    return quaternion if quaternion[0] >= 0 else -quaternion

"""The estimate as the contract's JSON (section 4). Built once, stored, and served as these bytes for good."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
import orjson

from service.errors import SkyposeError
from service.inference.articulation import Articulation, hold
from service.inference.params import SessionConfig
from service.inference.pose import yaw_pitch_roll_deg
from service.inference.smoothed import SmoothedEstimate
from service.inference.state import Estimate, Mode, PoseEstimate, Rates, Spread
from service.sessions.absolute import View, attitude_document, camera_document
from service.sessions.lighting import UNKNOWN, Lit
from service.workers.base import PackedFrameReport

_PARTS = 10**9


@dataclass(frozen=True)
class JointNames:
    """Names of the estimated joints, in the order of the pose's columns, and the values of the fixed ones."""

    free: tuple[str, ...]
    fixed: Mapping[str, float]

    @classmethod
    def of(cls, articulation: Articulation, config: SessionConfig) -> JointNames:
        """Of a session of this model."""
        estimated = hold(articulation, config.joints.free, config.joints.fixed)
        return cls(tuple(joint.name for joint in estimated.joints), dict(config.joints.fixed))


def estimate_document(
    session_id: str,
    index: int,
    time: str,
    names: JointNames,
    report: PackedFrameReport,
    view: View | None = None,
    models: Sequence[Mapping[str, Any]] | None = None,
    orbit: Mapping[str, Any] | None = None,
    lit: Lit = UNKNOWN,
    assumed: Sequence[str] = (),
    warnings: Sequence[str] = (),
) -> bytes:
    """The answer to a frame as JSON bytes; ``view`` is the camera among the stars, where it is known.

    ``models`` are those that the session compares, the one of ``report`` first. ``orbit``: where the object stands.
    ``lit``: where its light comes from; ``assumed``: what nobody told, ``warnings``: what does
    not agree.

    Raises ``SkyposeError`` if a number in it is not finite.
    """
    estimate = report.estimate
    data = {
        "session_id": session_id,
        "index": index,
        "time": time,
        "status": estimate.status,
        "duplicate": False,
        "mean": _pose(estimate.mean, names, view, estimate.spread),
        "best": {
            **_pose(estimate.best, names, view),
            "log_likelihood": float(estimate.best_log_likelihood),
        },
        "spread": _full_spread(estimate.spread, names),
        "modes": _modes(estimate.modes, names, view),
        "rates": _rates(estimate.rates, names),
        "particles": int(estimate.n_particles),
        "ess": float(estimate.ess),
        "log_evidence": float(estimate.log_evidence),
        "camera": None if view is None else camera_document(view),
        "light": lit.document(),
        "timing_ms": {name: round(float(value), 3) for name, value in report.timing_ms.items()},
        "scorer": report.scorer,
        "assumed": list(assumed),
        "warnings": list(warnings),
    }
    data |= _existence(estimate, names)
    if models is not None:
        data["models"] = list(models)
    if orbit is not None:
        data["orbit"] = dict(orbit)
    _require_finite(data, "estimate")  # orjson would write null
    return orjson.dumps(data)


def _existence(estimate: Estimate, names: JointNames) -> dict[str, Any]:
    """What only a filter says that weighs hypotheses."""
    found: dict[str, Any] = {}
    if estimate.probabilities is not None:
        found["probabilities"] = _named(("absent", "fits", "no_fit"), estimate.probabilities.tolist())
    if estimate.fit is not None:
        found["fit"] = asdict(estimate.fit)
    if estimate.spread_all is not None:
        found["spread_all"] = _full_spread(estimate.spread_all, names)
    return found


def as_duplicate(document: bytes) -> bytes:
    """The same answer, marked as given before."""
    return orjson.dumps({**orjson.loads(document), "duplicate": True})


def smoothed_document(
    filtered: Mapping[str, Any], names: JointNames, smoothed: SmoothedEstimate | None, view: View | None
) -> bytes:
    """A stored estimate with the smoothed poses, spreads, modes and rates in the place of the filter's.

    ``smoothed`` None: nothing is known beyond the filter's own answer, which stays. Likelihood, evidence and time
    are the filter's; a smoothed pose has no likelihood of its own.
    """
    if smoothed is None:
        return orjson.dumps({**filtered, "smoothed": False})
    both = "spread_all" in filtered  # of a filter that tells them apart
    spread = smoothed.spread if both else smoothed.spread_all
    data = {
        "mean": _pose(smoothed.mean, names, view, spread),
        "best": {**_pose(smoothed.best, names, view), "log_likelihood": None},
        "spread": _full_spread(spread, names),
        **({"spread_all": _full_spread(smoothed.spread_all, names)} if both else {}),
        "modes": _modes(smoothed.modes, names, view),
        "rates": _rates(smoothed.rates, names),
        "smoothed": True,
    }
    _require_finite(data, "estimate")
    return orjson.dumps({**filtered, **data})


def _modes(modes: Sequence[Mode], names: JointNames, view: View | None) -> list[dict[str, Any]]:
    return [
        {"weight": weight, "pose": _pose(mode.pose, names, view), "spread": _spread(mode.spread, names)}
        for mode, weight in zip(modes, decimal_shares([mode.weight for mode in modes]), strict=True)
    ]


def decimal_shares(shares: Sequence[float]) -> list[float]:
    """Shares, the largest first, with nine decimals, so that the decimals as written sum to what the shares do: 1."""
    parts = np.rint(np.multiply(shares, _PARTS))
    parts[:1] += np.rint(np.sum(shares) * _PARTS) - np.sum(parts)
    return [float(part) for part in parts / _PARTS]


def _rates(rates: Rates | None, names: JointNames) -> dict[str, Any] | None:
    if rates is None:
        return None
    joints = zip(rates.velocity[6:].tolist(), rates.deviation[6:].tolist(), strict=True)
    return {
        "angular_velocity_deg_s": _named("xyz", np.rad2deg(rates.velocity[:3]).tolist()),
        "spread_deg_s": _named("xyz", np.rad2deg(rates.deviation[:3]).tolist()),
        "joints": {
            name: {"rate_per_s": rate, "spread_per_s": deviation}
            for name, (rate, deviation) in zip(names.free, joints, strict=True)
        },
    }


def _full_spread(spread: Spread, names: JointNames) -> dict[str, Any]:
    return {
        **_spread(spread, names),
        "covariance": spread.covariance.tolist(),
        "covariance_order": [
            *("rx_deg", "ry_deg", "rz_deg", "x_px", "y_px", "log_scale"),
            *(f"joint:{name}" for name in names.free),
        ],
    }


def _pose(pose: PoseEstimate, names: JointNames, view: View | None, spread: Spread | None = None) -> dict[str, Any]:
    w, x, y, z = (pose.quaternion if pose.quaternion[0] >= 0 else -pose.quaternion).tolist()
    yaw, pitch, roll = yaw_pitch_roll_deg(pose.quaternion).tolist()
    return {
        "orientation": {"w": w, "x": x, "y": y, "z": z},
        "yaw_deg": yaw,
        "pitch_deg": pitch,
        "roll_deg": roll,
        "x_px": float(pose.position[0]),
        "y_px": float(pose.position[1]),
        "scale_px": float(pose.scale),
        "joints": {**_named(names.free, pose.joints.tolist()), **names.fixed},
        "attitude": None if view is None else attitude_document(view, pose, spread),
    }


def _spread(spread: Spread, names: JointNames) -> dict[str, Any]:
    return {
        "orientation_deg": float(spread.orientation_deg),
        "yaw_deg": float(spread.yaw_deg),
        "pitch_deg": float(spread.pitch_deg),
        "roll_deg": float(spread.roll_deg),
        "x_px": float(spread.x_px),
        "y_px": float(spread.y_px),
        "scale_px": float(spread.scale_px),
        "joints": _named(names.free, spread.joints.tolist()),
    }


def _named(names: Sequence[str], values: Sequence[float]) -> dict[str, float]:
    return dict(zip(names, values, strict=True))


def _require_finite(value: Any, path: str) -> None:
    if isinstance(value, float):
        if not math.isfinite(value):
            raise SkyposeError(f"{path} is not finite")
    elif isinstance(value, dict):
        for name, item in value.items():
            _require_finite(item, f"{path}.{name}")
    elif isinstance(value, list):
        for item in value:
            _require_finite(item, path)

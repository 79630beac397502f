"""Every estimate as a row: CSV for spreadsheets, NPZ for NumPy. Frames without an absolute attitude are in it too."""

from __future__ import annotations

import csv
import io
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from service.exports.history import PoseName

_POSE = ("x_px", "y_px", "scale_px", "yaw_deg", "pitch_deg", "roll_deg")
_RATE = "angular_velocity_body_deg_s"
_NAN = float("nan")


def write_csv(estimates: Sequence[Mapping[str, Any]], joints: Mapping[str, str], pose: PoseName) -> str:
    """Rows of text; what is unknown is left empty. ``joints``: the unit of each, by its name."""
    buffer = io.StringIO()
    writer = csv.writer(buffer)
    columns = ["index", "time", "status", "qw", "qx", "qy", "qz", *_POSE, *_joint_columns(joints)]
    columns += ["orientation_spread_deg", "ess", "log_evidence", *(f"gcrf_q{axis}" for axis in "wxyz")]
    columns += [f"body_rate_{axis}_deg_s" for axis in "xyz"]
    writer.writerow(columns)
    for estimate in estimates:
        found = estimate[pose]
        attitude = found.get("attitude") or {}
        writer.writerow(
            [estimate["index"], estimate["time"], estimate["status"], *_elements(found["orientation"])]
            + [found[name] for name in _POSE]
            + [found["joints"][name] for name in joints]
            + [estimate["spread"]["orientation_deg"], estimate["ess"], estimate["log_evidence"]]
            + (_elements(attitude["orientation"]) if attitude else [""] * 4)
            + list(attitude.get(_RATE) or [""] * 3)
        )
    return buffer.getvalue()


def write_npz(estimates: Sequence[Mapping[str, Any]], joints: Mapping[str, str], pose: PoseName) -> bytes:
    """Named arrays; what is unknown is NaN. Times are strings, ISO 8601; quaternions w, x, y, z."""
    poses = [estimate[pose] for estimate in estimates]
    attitudes = [found.get("attitude") or {} for found in poses]
    unknown = dict.fromkeys("wxyz", _NAN)
    arrays = {
        "index": np.array([estimate["index"] for estimate in estimates], dtype=np.int64),
        "time": np.array([estimate["time"] for estimate in estimates], dtype=np.str_),
        "status": np.array([estimate["status"] for estimate in estimates], dtype=np.str_),
        "orientation": _rows([_elements(found["orientation"]) for found in poses], 4),
        "attitude_gcrf": _rows([_elements(found.get("orientation") or unknown) for found in attitudes], 4),
        _RATE: _rows([found.get(_RATE) or [_NAN] * 3 for found in attitudes], 3),
        "position_px": _rows([[found["x_px"], found["y_px"]] for found in poses], 2),
        "scale_px": np.array([found["scale_px"] for found in poses], dtype=np.float64),
        "joint_names": np.array(list(joints), dtype=np.str_),
        "joint_units": np.array(list(joints.values()), dtype=np.str_),
        "joints": _rows([[found["joints"][name] for name in joints] for found in poses], len(joints)),
        "orientation_spread_deg": np.array([e["spread"]["orientation_deg"] for e in estimates], dtype=np.float64),
        "covariance": np.array([e["spread"]["covariance"] for e in estimates], dtype=np.float64),
        "ess": np.array([e["ess"] for e in estimates], dtype=np.float64),
        "log_evidence": np.array([e["log_evidence"] for e in estimates], dtype=np.float64),
    }
    buffer = io.BytesIO()
    np.savez(buffer, allow_pickle=False, **arrays)
    return buffer.getvalue()


def _joint_columns(joints: Mapping[str, str]) -> list[str]:
    return [f"joint:{name}_{unit}" for name, unit in joints.items()]


def _elements(orientation: Mapping[str, float]) -> list[float]:
    return [orientation[axis] for axis in "wxyz"]


def _rows(values: list[list[float]], width: int) -> np.ndarray[Any, np.dtype[np.float64]]:
    return np.array(values, dtype=np.float64).reshape(len(values), width)

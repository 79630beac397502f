"""The spin of an object over its passes, as the API answers it (docs/objects.md)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from datetime import datetime, timedelta
from typing import Any

import numpy as np

from service.inference.spin.passes import PassSpin, Spin, spin_of
from service.sessions.frame import format_time

_DAY_S = 86_400.0
_SEEN_SIGMAS = 3.0  # a change that is less is told as none
_MUCH_SCATTER = 2.0
_SWUNG_RAD = 0.35  # 20 degrees: more than tracks err by


def spin_document(object_id: str, motions: Sequence[Mapping[str, Any]], left_out: Sequence[Any]) -> dict[str, Any]:
    """``motions``: of passes in order of time, as the API answers them, against GCRF and with a period."""
    start = datetime.fromisoformat(motions[0]["epoch"])
    found = spin_of([_pass_spin(one, start) for one in motions])
    degrees = float(np.rad2deg(1.0))
    period, change = found.period_s, found.period_change
    return {
        "object_id": object_id,
        "epoch": format_time(start + timedelta(seconds=found.time_s)),
        "rate_deg_s": abs(found.rate) * degrees,
        "rate_sigma_deg_s": found.rate_sigma * degrees,
        "period_s": abs(period[0]),
        "period_sigma_s": period[1],
        "period_change_s_per_day": float(np.sign(found.rate)) * change[0] * _DAY_S,
        "period_change_sigma_s_per_day": change[1] * _DAY_S,
        "axis_gcrf": dict(zip("xyz", (float(np.sign(found.rate)) * found.axis).tolist(), strict=True)),
        "axis_gcrf_sigma_deg": found.axis_sigma * degrees,
        "scale": found.scale,
        "passes": [_line(k, one, found) for k, one in enumerate(motions)],
        "left_out": list(left_out),
        "warnings": _warnings(motions, found),
    }


def _pass_spin(motion: Mapping[str, Any], start: datetime) -> PassSpin:
    axis, q = motion["axis_gcrf"], motion["orientation"]
    sigma = float(np.deg2rad(motion["orientation_sigma_deg"])) / np.sqrt(3)  # about one axis of three
    return PassSpin(
        time_s=(datetime.fromisoformat(motion["epoch"]) - start).total_seconds(),
        quaternion=np.array([q[name] for name in "wxyz"]),
        # A tumbling body's orientation is not told by one phase: nothing is counted from it.
        phase_sigma=sigma if motion["model"] == "constant_rate" else np.pi,
        rate=float(np.deg2rad(motion["rate_deg_s"])),
        rate_sigma=float(np.deg2rad(motion["rate_sigma_deg_s"])),
        axis=np.array([axis[name] for name in "xyz"]),
        axis_sigma=float(np.deg2rad(motion["axis_gcrf_sigma_deg"])),
    )


def _line(k: int, motion: Mapping[str, Any], found: Spin) -> dict[str, Any]:
    gap = found.gaps[k - 1] if k else None
    names = ("pass", "epoch", "model", "rate_deg_s", "rate_sigma_deg_s", "period_s", "period_sigma_s", "axis_gcrf")
    return {
        **{name: motion[name] for name in names},
        "turns_since_last": None if gap is None or gap.turns is None else abs(gap.turns),
        "turns_since_last_sigma": None if gap is None else gap.sigma_turns,
        "swing_since_last_deg": None if gap is None else float(np.rad2deg(gap.swing)),
    }


def _warnings(motions: Sequence[Mapping[str, Any]], found: Spin) -> list[str]:
    out = []
    open_gaps = sum(gap.turns is None for gap in found.gaps)
    if open_gaps:
        out.append(f"turns cannot be counted over {open_gaps} of {len(found.gaps)} gaps: rates alone tell of these")
    if any(gap.swing > _SWUNG_RAD for gap in found.gaps):
        out.append("orientations differ by more than a turn about the axis: it was not kept, or a pass is wrong")
    if found.scale > _MUCH_SCATTER:
        out.append("passes differ by more than they state: the rate does not change steadily, or a pass is wrong")
    if any(one["model"] == "tumbling" for one in motions):
        out.append("the object tumbles in some passes: nothing is counted from these")
    if abs(found.change) < _SEEN_SIGMAS * found.change_sigma:
        out.append("no change of the period is seen beyond its spread")
    return out

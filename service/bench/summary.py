"""From frames to a row per pass, and from rows to a line per preset.

``err1``, ``err5``, ``err10``: orientation error (degrees) of the best pose in the first frame that shows the object
from frame 1, 5, 10 on. The other figures are over the visible frames after the first ten (``--from`` says how many;
all, in a shorter pass):
``err_med``, ``err_p95``; ``within5``, ``modes5``: share of frames in which the best pose, the nearest mode, is off
by less than 5 degrees; ``right_twin``: share in which the best pose is, and is no symmetry-equivalent of the truth;
``silent``: share answered ``tracking`` although the best pose and the nearest mode are off by more than 15 degrees;
``tracked``: share of all frames that show the object, from the first one, that is answered ``tracking``, and
``tracked_right``, of those: off by less than 5 degrees;
``pos_med`` (px), ``scale_med`` (%), ``joint_med`` (degrees, the worst joint), ``iou_med``; ``joints90``: share of
joints within the 90 % interval that the nearest mode states; ``cover50``, ``cover90``: share of frames in which the
nearest mode's error lies within its own 50 and 90 % radius, were it an isotropic Gaussian of its RMS spread;
``region50``, ``region90``: within the region that the mode itself states, a Student t's of its covariance; ``ms_med``,
``ms_p95``: time per frame, from the image file to the answer. ``first_ms``: the same of the first frame that shows the
object, the model being prepared.
``blank_ok``: share of the frames without the object that are answered ``no_target``; ``reacquired``: frames after
the last of them until a mode is within 5 degrees. ``twins_reported``: share of frames that report both sides of a
mirror-symmetric body within 5 degrees. Over all passes, ``hard90``: ``cover90`` over the quarter of them with the
greatest ``err_med``.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from typing import Any

import numpy as np
from scipy.stats import chi2

from service.bench.runner import CaseResult
from service.bench.scoring import FrameScore
from service.inference.state import Array

WITHIN_DEG = 5.0
SILENT_DEG = 15.0  # off by more than this, an answer ought not to be ``tracking``
FIRST_WITHIN_DEG = 10.0
Row = dict[str, Any]


def radius_factor(share: float | Array) -> Array:
    """Radius that holds a share of an isotropic three-dimensional Gaussian, over its RMS length (0.888 for half)."""
    return np.asarray(np.sqrt(chi2.ppf(share, 3) / 3))


def settled(result: CaseResult) -> list[FrameScore]:
    """The visible frames from number ``settled_frame`` on; all of them where there are no more."""
    seen = [frame for frame in result.frames if frame.visible]
    return seen[result.settled_frame :] or seen


def coverage(frames: Iterable[FrameScore], share: float) -> float:
    """Share of frames whose nearest mode lies within the radius that should hold ``share`` of them."""
    factor = round(float(radius_factor(share)), 3)
    return float(np.mean([frame.ratio <= factor for frame in frames]))


def case_row(result: CaseResult) -> Row:
    """The figures of one pass. Raises ``ValueError`` for a pass that never shows the object."""
    seen = [frame for frame in result.frames if frame.visible]
    if not seen:
        raise ValueError(f"{result.case}: no frame shows the object")
    late = settled(result)
    blank = [frame for frame in result.frames if not frame.visible]
    twins = [frame.twins_reported for frame in late if frame.twins_reported is not None]
    statuses = sorted({frame.status for frame in result.frames})
    tracked = [frame for frame in seen if frame.status == "tracking"]
    return {
        "preset": result.entry,
        "case": result.case,
        "frames": len(result.frames),
        **{f"err{k}": _error_from(seen, k) for k in (1, 5, 10)},
        "err_med": _median(late, lambda f: f.orientation_deg, 2),
        "err_p95": round(float(np.percentile([f.orientation_deg for f in late], 95)), 2),
        "within5": _share(f.orientation_deg < WITHIN_DEG for f in late),
        "modes5": _share(f.modes_deg < WITHIN_DEG for f in late),
        "right_twin": _share(f.raw_deg < WITHIN_DEG for f in late),
        "silent": _share(map(_is_silent, late)),
        "tracked": _share(f.status == "tracking" for f in seen),
        "tracked_right": _share(f.orientation_deg < WITHIN_DEG for f in tracked) if tracked else None,
        "pos_med": _median(late, lambda f: f.position_px, 2),
        "scale_med": _median(late, lambda f: f.scale_percent, 2),
        "joint_med": _median(late, lambda f: f.joint, 2),
        "joints90": round(float(np.mean([f.joints90 for f in late])), 2) if result.n_joints else None,
        "joints": result.n_joints,
        "iou_med": _median(late, lambda f: f.iou, 3),
        "cover50": round(coverage(late, 0.5), 2),
        "cover90": round(coverage(late, 0.9), 2),
        "region50": _share((f.region <= 0.5 for f in late), 2),
        "region90": _share((f.region <= 0.9 for f in late), 2),
        "blank_ok": _share((f.status == "no_target" for f in blank), 2) if blank else None,
        "reacquired": _reacquired(result.frames),
        "twins_reported": _share(twins) if twins else None,
        "first_ms": round(seen[0].ms, 1),
        "ms_med": _median(late, lambda f: f.ms, 1),
        "ms_p95": round(float(np.percentile([f.ms for f in late], 95)), 1),
        "status": "/".join(statuses),
        **{name: round(value, 2) for name, value in result.facts.items()},
    }


def overall_row(preset: str, rows: Sequence[Row]) -> Row:
    """One line over the passes of a preset: medians of medians, means of shares, and shares acquired."""
    mine = [row for row in rows if row["preset"] == preset]
    return {
        "preset": preset,
        "cases": len(mine),
        "acquired1": _below(mine, "err1", FIRST_WITHIN_DEG),
        "acquired10": _below(mine, "err10", WITHIN_DEG),
        **{name: _over(mine, name, np.median, 2) for name in ("err_med", "err_p95")},
        "err_worst": max(row["err_med"] for row in mine),
        **{name: _over(mine, name, np.mean, 3) for name in ("within5", "modes5", "right_twin", "silent")},
        "tracked": _over(mine, "tracked", np.mean, 3),
        "tracked_right": _tracked_right(mine),
        **{name: _over(mine, name, np.median, 2) for name in ("pos_med", "scale_med")},
        "joint_med": _over([row for row in mine if row["joints"]], "joint_med", np.median, 2),
        "joints90": _over(mine, "joints90", np.mean, 3),
        "iou_med": _over(mine, "iou_med", np.mean, 3),
        **{name: _over(mine, name, np.mean, 3) for name in ("cover50", "cover90", "region50", "region90")},
        **{name: _over(mine, name, np.mean, 3) for name in ("blank_ok", "twins_reported")},
        "hard90": _over(_hardest(mine), "cover90", np.mean, 3),
        "reacquired": _over(mine, "reacquired", np.max, 0),
        **{name: _over(mine, name, np.median, 1) for name in ("first_ms", "ms_med", "ms_p95")},
    }


def _is_silent(frame: FrameScore) -> bool:
    """Whether an answer far off does not say so."""
    return frame.status == "tracking" and frame.orientation_deg > SILENT_DEG and frame.modes_deg > SILENT_DEG


def _tracked_right(rows: Sequence[Row]) -> float | None:
    """Of all frames that are answered ``tracking``, each counting as much as in its pass."""
    some = [row for row in rows if row["tracked"]]
    if not some:
        return None
    return round(float(np.average([row["tracked_right"] for row in some], weights=[row["tracked"] for row in some])), 4)


def _hardest(rows: Sequence[Row]) -> list[Row]:
    """The quarter of the passes with the greatest median error, one at least."""
    return sorted(rows, key=lambda row: -row["err_med"])[: max(1, len(rows) // 4)]


def _error_from(seen: Sequence[FrameScore], number: int) -> float | None:
    """Error in the first visible frame from frame ``number`` (counted from 1) on."""
    return next((round(f.orientation_deg, 1) for f in seen if f.index >= number - 1), None)


def _reacquired(frames: Sequence[FrameScore]) -> int | None:
    """Frames from the end of the last outage until a mode is right again; one more than there are if none is."""
    blank = [k for k, frame in enumerate(frames) if not frame.visible]
    after = frames[blank[-1] + 1 :] if blank else ()
    if not after:
        return None
    return next((k for k, f in enumerate(after, start=1) if f.modes_deg < WITHIN_DEG), len(after) + 1)


def _median(frames: Sequence[FrameScore], figure: Callable[[FrameScore], float], digits: int) -> float:
    return round(float(np.median([figure(frame) for frame in frames])), digits)


def _share(found: Iterable[bool], digits: int = 3) -> float:
    return round(float(np.mean(list(found))), digits)


def _below(rows: Sequence[Row], name: str, bound: float) -> float | None:
    """Share of the passes that are long enough to tell."""
    values = [row[name] for row in rows if row[name] is not None]
    return _share(value < bound for value in values) if values else None


def _over(rows: Sequence[Row], name: str, statistic: Callable[[list[float]], Any], digits: int) -> float | None:
    values = [row[name] for row in rows if row[name] is not None]
    return round(float(statistic(values)), digits) if values else None

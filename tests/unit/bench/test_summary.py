"""Rows from frames: the definitions, and that the public evaluator computes the same."""

import math
from dataclasses import replace

import numpy as np
import pytest

from service.bench.report import case_table, markdown_table, overall_columns, overall_rows, overall_table
from service.bench.runner import CaseResult
from service.bench.scoring import FrameScore
from service.bench.summary import case_row, coverage, radius_factor


def frame(k, **figures):
    made = FrameScore(k, 0.1 * k, True, "tracking", 20.0 + k, 1.0, 0.5, 0.8, 0.3, 0.4, 0.0, 0.95, 1, None)
    return replace(made, **figures)


def blank(k, status="no_target"):
    return FrameScore(k, 0.1 * k, False, status, 5.0)


def result(frames, entry="balanced", case="a", joints=0, settled_frame=10):
    return CaseResult(entry, case, tuple(frames), {"snr": 12.345}, joints, "numpy:reference", settled_frame)


def test_the_hardest_quarter_is_asked_for_its_regions():
    medians, covered = [1.0, 50.0, 2.0, 9.0, 3.0, 4.0, 5.0, 6.0, 7.0], [1, 0, 1, 1, 1, 1, 1, 1, 1]
    rows = [
        case_row(result((frame(k, orientation_deg=e, ratio=0.1 if c else 9.0) for k in range(12)), case=str(e)))
        for e, c in zip(medians, covered, strict=True)
    ]
    (total,) = overall_rows(rows, {})
    assert total["hard90"] == 0.5  # the mean of two of nine: 50 and 9 degrees off
    assert overall_rows(rows[:3], {})[0]["hard90"] == 0.0  # of three, the one that is worst


def test_what_is_told_as_tracked_is_asked_whether_it_is_right():
    right = case_row(result((frame(k, status="tracking" if k > 3 else "acquiring") for k in range(12)), case="a"))
    wrong = case_row(result((frame(k, orientation_deg=6.0 if k == 11 else 1.0) for k in range(12)), case="b"))
    never = case_row(result((frame(k, status="no_fit", orientation_deg=90.0) for k in range(12)), case="c"))
    assert (right["tracked"], right["tracked_right"]) == (0.667, 1.0)
    assert (wrong["tracked"], wrong["tracked_right"], never["tracked_right"]) == (1.0, 0.917, None)
    (total,) = overall_rows([right, wrong, never], {})
    assert total["tracked"] == 0.556 and total["tracked_right"] == pytest.approx(19 / 20, abs=1e-3)
    assert overall_rows([never], {})[0]["tracked_right"] is None


def test_early_frames_count_for_acquisition_only():
    errors = [90.0] * 4 + [20.0] * 5 + [3.0] * 11
    row = case_row(result(frame(k, orientation_deg=e) for k, e in enumerate(errors)))
    assert (row["err1"], row["err5"], row["err10"], row["err_med"], row["within5"]) == (90.0, 20.0, 3.0, 3.0, 1.0)
    assert row["snr"] == 12.35
    assert row["first_ms"] == 20.0
    assert row["blank_ok"] is row["reacquired"] is row["twins_reported"] is None


def test_an_outage_is_answered_and_ends():
    frames = [frame(k) for k in range(12)] + [blank(12), blank(13, "tracking")]
    frames += [frame(14, modes_deg=50.0), frame(15)]
    row = case_row(result(frames))
    assert (row["blank_ok"], row["reacquired"]) == (0.5, 2)
    never = [*frames[:14], frame(14, modes_deg=50.0)]
    assert case_row(result(never))["reacquired"] == 2  # one more than there are


def test_a_pass_that_shows_nothing_is_refused():
    with pytest.raises(ValueError, match="no frame shows"):
        case_row(result([blank(0)]))


def test_regions_of_a_gaussian_cover_what_they_say():
    assert radius_factor(0.5) == pytest.approx(0.888, abs=1e-3)
    assert radius_factor(0.9) == pytest.approx(1.443, abs=1e-3)
    lengths = np.linalg.norm(np.random.default_rng(0).standard_normal((20_000, 3)), axis=1) / np.sqrt(3)
    frames = [frame(0, ratio=ratio) for ratio in lengths]
    for share in (0.1, 0.5, 0.9):
        assert coverage(frames, share) == pytest.approx(share, abs=0.012)
    assert coverage([frame(0, ratio=math.nan)], 0.9) == 0.0  # a mode without a spread covers nothing


@pytest.mark.parametrize("first", [10, 5])
def test_the_public_evaluator_agrees(evaluator, monkeypatch, first):
    rng = np.random.default_rng(1)
    frames = [
        frame(k, orientation_deg=a, modes_deg=a / 2, ratio=r, position_px=p, scale_percent=s, joint=j, iou=i, ms=m)
        for k, (a, r, p, s, j, i, m) in enumerate(rng.uniform(0, 10, (30, 7)))
    ]
    frames = [replace(f, raw_deg=f.orientation_deg * rng.choice([1, 40])) for f in frames]
    for k, status in ((16, "tracking"), (17, "lost"), (18, "tracking")):
        frames[k] = replace(frames[k], status=status, orientation_deg=170.0, modes_deg=3.0 if k == 18 else 160.0)
    frames[12:15] = [blank(12), blank(13), blank(14, "lost")]
    monkeypatch.setattr(evaluator, "FROM", first)
    theirs = evaluator.summary("a", [_evaluator_row(f) for f in frames])
    ours = case_row(result(frames, settled_frame=first))
    shared_names = set(theirs) & set(ours)
    assert len(shared_names) >= 20
    assert 0 < ours["silent"] < ours["right_twin"] < ours["within5"]
    assert {name: ours[name] for name in shared_names} == {name: theirs[name] for name in shared_names}


def test_the_total_takes_medians_of_errors_and_means_of_shares():
    passes = [result([frame(k, orientation_deg=e) for k in range(12)], case=str(e)) for e in (1.0, 2.0, 30.0)]
    other = result([frame(k, twins_reported=k % 2 == 0) for k in range(12)], entry="paper", joints=1)
    rows = [case_row(r) for r in [*passes, other]]
    first, second = overall_rows(rows, {"paper": "as published"})
    assert (first["err_med"], first["err_worst"], first["within5"]) == (2.0, 30.0, pytest.approx(0.667))
    assert (first["acquired1"], first["acquired10"]) == (pytest.approx(0.667), pytest.approx(0.667))
    assert (first["joint_med"], second["joint_med"], second["twins_reported"]) == (None, 0.0, 0.5)
    assert overall_columns([first, second])[-1] == "says"
    assert "says" not in overall_columns([first])
    assert case_table(rows).row_count == 4
    assert len(overall_table([first, second]).columns) == 3
    lines = markdown_table([first, second], ("preset", "err_med", "joint_med", "says")).splitlines()
    assert lines[2:] == ["| balanced | 2 | - |  |", "| paper | 1 | 0 | as published |"]


def _evaluator_row(f):
    if not f.visible:
        return {"k": f.index, "status": f.status, "blank": True, "ms": f.ms}
    figures = {
        "err": f.orientation_deg,
        "err_raw": f.raw_deg,
        "err_modes": f.modes_deg,
        "pos": f.position_px,
        "scale": f.scale_percent,
    }
    rest = {"joint": f.joint, "iou": f.iou, "ratio": f.ratio, "ms": f.ms}
    return {"k": f.index, "status": f.status, **figures, **rest}

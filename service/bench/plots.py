"""The figures of a benchmark as PNG files: error over time, success, coverage, time per frame."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from service.bench.plotting import PlotsMissingError, require_matplotlib
from service.bench.runner import CaseResult
from service.bench.scoring import FrameScore
from service.bench.summary import Row, radius_factor, settled
from service.inference.state import Array

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = ["PlotsMissingError", "require_matplotlib", "write_plots"]

_MOST_PANELS = 12  # more passes than this are shown as one distribution
_COLUMNS = 3
_LEAST_DEG = 0.05
_BINS = 6
_COLOURS = [f"C{k}" for k in range(10)] + ["black", "gold", "navy", "lime", "salmon", "teal"]
CONDITIONS = {"snr": "SNR per pixel", "d_over_r0": "D / r0", "size_px": "size of the body, px"}


def write_plots(results: Sequence[CaseResult], rows: Sequence[Row], folder: Path) -> dict[str, str]:
    """Draw what the results allow; returns caption by file name."""
    require_matplotlib()
    entries = list(dict.fromkeys(result.entry for result in results))
    plots = {
        "error_over_time.png": ("Orientation error over time", _error_over_time(results, entries)),
        "coverage.png": ("Coverage of the stated credible regions", _coverage(results, entries)),
        "time_per_frame.png": ("Time per frame", _time_per_frame(results, entries)),
    }
    known = [name for name in CONDITIONS if any(name in row for row in rows)]
    if known:
        caption = "Success against " + ", ".join(CONDITIONS[name] for name in known)
        plots["success.png"] = (caption, _success(rows, entries, known))
    for name, (_, figure) in plots.items():
        figure.savefig(folder / name, dpi=110)
    return {name: caption for name, (caption, _) in plots.items()}


def _figure(rows: int, columns: int) -> tuple[Figure, list[Axes]]:
    from matplotlib.figure import Figure

    figure = Figure(figsize=(4.0 * columns, 3.0 * rows), layout="constrained")
    axes: Any = figure.subplots(rows, columns, squeeze=False)
    return figure, list(axes.ravel())


def _error_over_time(results: Sequence[CaseResult], entries: Sequence[str]) -> Figure:
    """A panel per pass, or the distribution over many passes."""
    cases = list(dict.fromkeys(result.case for result in results))
    if len(cases) > _MOST_PANELS:
        return _error_distribution(results, entries)
    figure, axes = _figure(-(-len(cases) // _COLUMNS), min(len(cases), _COLUMNS))
    for panel, case in zip(axes, cases, strict=False):
        for colour, entry in enumerate(entries):
            for result in results:
                if (result.entry, result.case) == (entry, case):
                    panel.plot(
                        *_error_line(result.frames), color=_COLOURS[colour % len(_COLOURS)], label=entry, linewidth=1.2
                    )
        panel.set_title(case, fontsize=9)
        _error_axis(panel)
    for panel in axes[len(cases) :]:
        panel.set_axis_off()
    axes[0].legend(fontsize=8)
    return figure


def _error_line(frames: Sequence[FrameScore]) -> tuple[list[float], list[float]]:
    """Time and error; a frame without the object leaves a gap (NaN)."""
    return [frame.time_s for frame in frames], [max(frame.orientation_deg, _LEAST_DEG) for frame in frames]


def _error_distribution(results: Sequence[CaseResult], entries: Sequence[str]) -> Figure:
    figure, (panel,) = _figure(1, 1)
    for colour, entry in enumerate(entries):
        mine = [result.frames for result in results if result.entry == entry]
        length = max(len(frames) for frames in mine)
        errors = np.full((len(mine), length), np.nan)
        for k, frames in enumerate(mine):
            errors[k, : len(frames)] = [max(frame.orientation_deg, _LEAST_DEG) for frame in frames]
        seen = np.any(np.isfinite(errors), axis=0)
        times = np.array([frame.time_s for frame in max(mine, key=len)])[seen]
        low, middle, high = np.nanquantile(errors[:, seen], (0.25, 0.5, 0.9), axis=0)
        panel.plot(times, middle, color=_COLOURS[colour % len(_COLOURS)], label=f"{entry}: median, 25 to 90 %")
        panel.fill_between(times, low, high, color=_COLOURS[colour % len(_COLOURS)], alpha=0.2, linewidth=0)
    _error_axis(panel)
    panel.legend(fontsize=8)
    return figure


def _error_axis(panel: Axes) -> None:
    panel.set_yscale("log")
    panel.set_ylim(_LEAST_DEG, 200)
    panel.axhline(5, color="grey", linewidth=0.6, linestyle=":")
    panel.set_xlabel("time, s")
    panel.set_ylabel("error, deg")


def _success(rows: Sequence[Row], entries: Sequence[str], known: Sequence[str]) -> Figure:
    """Share of frames within 5 degrees against each condition: passes as dots, means of equal groups as a line."""
    figure, axes = _figure(1, len(known))
    for panel, name in zip(axes, known, strict=True):
        for colour, entry in enumerate(entries):
            mine = [row for row in rows if row["preset"] == entry and name in row]
            x, y = (np.array([row[key] for row in mine], dtype=np.float64) for key in (name, "within5"))
            panel.plot(x, y, ".", color=_COLOURS[colour % len(_COLOURS)], alpha=0.5, label=entry)
            if len(mine) >= 2 * _BINS:
                line = [(x[group].mean(), y[group].mean()) for group in _groups(x)]
                panel.plot(*zip(*line, strict=True), color=_COLOURS[colour % len(_COLOURS)])
        panel.set_xlabel(CONDITIONS[name])
        panel.set_ylabel("frames within 5 deg")
        panel.set_ylim(-0.03, 1.03)
        if name == "snr":
            panel.set_xscale("log")
    axes[0].legend(fontsize=8)
    return figure


def _groups(x: Array) -> list[NDArray[np.intp]]:
    """Passes in groups of rising ``x``, of nearly equal size; those at the least value (no turbulence) are one."""
    order = np.argsort(x, kind="stable")
    least = int(np.count_nonzero(x == x.min()))
    if least * _BINS <= len(x) or least == len(x):
        return np.array_split(order, _BINS if least < len(x) else 1)
    return [order[:least], *np.array_split(order[least:], min(_BINS - 1, len(x) - least))]


def _coverage(results: Sequence[CaseResult], entries: Sequence[str]) -> Figure:
    """Share of frames inside the region of each stated share: on the diagonal if the spread can be trusted."""
    stated = np.linspace(0.01, 0.99, 99)
    figure, (panel,) = _figure(1, 1)
    panel.plot([0, 1], [0, 1], color="grey", linewidth=0.8)
    for colour, entry in enumerate(entries):
        ratio = np.array([f.ratio for r in results if r.entry == entry for f in settled(r)])
        found = [np.mean(ratio <= factor) for factor in radius_factor(stated)]
        panel.plot(stated, found, color=_COLOURS[colour % len(_COLOURS)], label=entry)
    panel.set_xlabel("stated share")
    panel.set_ylabel("share of frames inside")
    panel.legend(fontsize=8)
    return figure


def _time_per_frame(results: Sequence[CaseResult], entries: Sequence[str]) -> Figure:
    figure, (panel,) = _figure(1, 1)
    for colour, entry in enumerate(entries):
        ms = np.sort([f.ms for r in results if r.entry == entry for f in settled(r)])
        panel.plot(ms, np.arange(1, len(ms) + 1) / len(ms), color=_COLOURS[colour % len(_COLOURS)], label=entry)
        first = np.median([r.frames[0].ms for r in results if r.entry == entry])
        panel.axvline(
            first, color=_COLOURS[colour % len(_COLOURS)], linestyle=":", label=f"{entry}: first frame, median"
        )
    panel.set_xscale("log")
    panel.set_xlabel("ms per frame")
    panel.set_ylabel("share of frames")
    panel.legend(fontsize=8)
    return figure

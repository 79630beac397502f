"""Rows as tables: on the terminal, in Markdown, in JSON."""

from __future__ import annotations

import csv
from collections.abc import Mapping, Sequence
from dataclasses import asdict, fields
from pathlib import Path
from typing import Any

from rich.box import SIMPLE_HEAD
from rich.console import JustifyMethod
from rich.table import Table

from service.bench import summary
from service.bench.machine import machine_line
from service.bench.runner import CaseResult
from service.bench.scoring import FrameScore
from service.bench.summary import Row

CASE_COLUMNS = (
    *("preset", "case", "err1", "err5", "err10", "err_med", "err_p95", "within5", "modes5", "right_twin", "silent"),
    *("pos_med", "scale_med", "joint_med", "joints90", "iou_med", "cover50", "cover90", "region50", "region90"),
    *("blank_ok", "twins_reported", "first_ms", "ms_med"),
)
OVERALL_COLUMNS = (
    *("preset", "cases", "acquired1", "acquired10", "err_med", "err_worst", "within5", "modes5", "right_twin"),
    *("silent", "tracked", "tracked_right", "pos_med", "scale_med", "joint_med", "joints90", "iou_med"),
    *("cover50", "cover90", "region50", "region90", "hard90", "blank_ok", "reacquired", "twins_reported"),
    *("first_ms", "ms_med"),
)
_MOST_COLUMNS = 4
_TEXT = ("preset", "case", "says")
_SHORT = {
    "acquired1": "acq1",
    "acquired10": "acq10",
    "err_med": "med",
    "err_worst": "worst",
    "reacquired": "reacq",
    "err_p95": "p95",
    "within5": "in5",
    "modes5": "m5",
    "right_twin": "right",
    "tracked": "T",
    "tracked_right": "T in5",
    "pos_med": "pos",
    "scale_med": "scale",
    "joint_med": "joint",
    "joints90": "j90",
    "iou_med": "iou",
    "cover50": "c50",
    "cover90": "c90",
    "region50": "r50",
    "region90": "r90",
    "hard90": "h90",
    "blank_ok": "blank",
    "twins_reported": "twins",
    "first_ms": "1st ms",
    "ms_med": "ms",
}


def overall_rows(rows: Sequence[Row], says: Mapping[str, str]) -> list[Row]:
    """One line per preset, in the order of their first row, with what is said of it."""
    names = dict.fromkeys(row["preset"] for row in rows)
    return [{**summary.overall_row(name, rows), "says": says.get(name, "")} for name in names]


def overall_columns(total: Sequence[Row]) -> tuple[str, ...]:
    """The columns of a table of such lines: what is said of a preset only where something is."""
    return (*OVERALL_COLUMNS, "says") if any(row["says"] for row in total) else OVERALL_COLUMNS


def case_table(rows: Sequence[Row]) -> Table:
    """A line per pass, for a wide terminal."""
    return _table("each pass", rows, CASE_COLUMNS)


def overall_table(total: Sequence[Row]) -> Table:
    """A column per preset and a line per figure; the other way round where the presets are many."""
    if len(total) > _MOST_COLUMNS:
        return _table("over all passes", total, OVERALL_COLUMNS)
    table = Table(title="over all passes", title_justify="left", box=SIMPLE_HEAD, pad_edge=False)
    table.add_column("")
    for row in total:
        table.add_column(str(row["preset"]), justify="right")
    for name in OVERALL_COLUMNS[1:]:
        table.add_row(name, *(_cell(row, name) for row in total))
    return table


def _table(title: str, rows: Sequence[Row], columns: Sequence[str]) -> Table:
    table = Table(title=title, title_justify="left", box=SIMPLE_HEAD, pad_edge=False)
    for name in columns:
        justify: JustifyMethod = "left" if name in _TEXT else "right"
        table.add_column(_SHORT.get(name, name), justify=justify, no_wrap=True)
    for row in rows:
        table.add_row(*(_cell(row, name) for name in columns))
    return table


def markdown_table(rows: Sequence[Row], columns: Sequence[str]) -> str:
    """For a page."""
    head = "| " + " | ".join(columns) + " |"
    rule = "|" + "|".join("---" if name in _TEXT else "--:" for name in columns) + "|"
    body = ["| " + " | ".join(_cell(row, name) for name in columns) + " |" for row in rows]
    return "\n".join([head, rule, *body])


def markdown_report(
    title: str,
    command: str,
    machine: Mapping[str, Any],
    rows: Sequence[Row],
    total: Sequence[Row],
    plots: Mapping[str, str],
) -> str:
    """The whole page: machine, tables, plots, what the columns mean. ``plots``: caption by file name."""
    parts = [
        f"# {title}",
        f"`{command}`",
        f"Measured on: {machine_line(machine)}.",
        "## Over all passes",
        markdown_table(total, overall_columns(total)),
        *(f"![{caption}]({name})\n\n{caption}." for name, caption in plots.items()),
        "## Each pass",
        markdown_table(rows, CASE_COLUMNS),
        "## Columns",
        (summary.__doc__ or "").partition("\n\n")[2].strip(),
        "Over all passes: medians of the passes' medians, means of their shares; `acquired1`, `acquired10`: share of "
        "passes within 10 degrees in the first frame, within 5 by the tenth; `err_worst`: the greatest `err_med`; "
        "`reacquired`: the longest. Orientation errors are modulo the body's symmetries.",
    ]
    return "\n\n".join(parts) + "\n"


def write_frames(results: Sequence[CaseResult], path: Path) -> None:
    """Every frame's figures as CSV."""
    columns = [field.name for field in fields(FrameScore)]
    with path.open("w", newline="") as file:
        out = csv.writer(file)
        out.writerow(["preset", "case", *columns])
        for result in results:
            for frame in result.frames:
                figures = asdict(frame)
                out.writerow([result.entry, result.case, *(figures[name] for name in columns)])


def _cell(row: Row, name: str) -> str:
    value = row.get(name)
    if value is None or (name == "joint_med" and row.get("joints") == 0):
        return "-"
    return f"{value:g}" if isinstance(value, float) else str(value)

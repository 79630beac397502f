"""What ``skypose bench likelihood`` shows: shares and medians over all frames, tables, JSON, a page."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, fields
from typing import Any

import numpy as np
from rich.box import SIMPLE_HEAD
from rich.table import Table

from service.bench.likelihood import LikelihoodRow
from service.bench.likelihood_basins import NEAR_DEG
from service.bench.machine import machine_line
from service.bench.report import markdown_table
from service.bench.summary import Row

FAR_BEHIND_NATS = 5.0
"""A truth that loses by more has not lost by chance."""
_MEDIANS = ("rough_nats", "bank_ms", "search_ms", "evidence_ms", "draw_us")
MEANINGS = {
    "n": "frames",
    "truth_wins": "share in which the refined truth beats all other basins that the search met",
    "lost_far": f"share in which it loses by more than {FAR_BEHIND_NATS:g} nats",
    "worst_nats": "the smallest margin",
    "beats_twin": "share in which the truth beats its refined mirror twin, of the bodies with a mirror plane",
    "found": f"share in which the search ends within {NEAR_DEG:g}° of the truth",
    "right_twin": "share of those within 5° of the truth or its mirror twin that are at the truth",
    "refined_med": "degrees that are left of 2° after refinement: median",
    "refined_p90": "the same: 90th percentile",
    "in50_calm": "share within its own 50 % region afterwards, calm air",
    "in90_calm": "within the 90 % region",
    "in50_turbulent": "the same in turbulence",
    "in90_turbulent": "",
    "rough_nats": "median: what samples and texels add to the evidence of neighbouring poses",
    "bank_ms": "median: templates, once a pass",
    "search_ms": "median: of one frame",
    "evidence_ms": "median: of one pose, finely",
    "draw_us": "median: of one of 64 poses, 64 px a side",
}


def overall(rows: Sequence[LikelihoodRow]) -> Row:
    """All frames in a line. None: no frame to tell from."""
    margins = [row.margin_nats for row in rows if row.margin_nats is not None]
    twins = [row.twin_margin_nats for row in rows if row.twin_margin_nats is not None]
    calm = [row for row in rows if not row.turbulent]
    rough = [row for row in rows if row.turbulent]
    refined = [row.refined_err_deg for row in rows]
    return {
        "n": len(rows),
        "truth_wins": _share([row.truth_wins for row in rows]),
        "lost_far": _share([row.margin_nats is not None and row.margin_nats < -FAR_BEHIND_NATS for row in rows]),
        "worst_nats": _rounded(min(margins, default=None)),
        "beats_twin": _share([nats >= 0 for nats in twins]),
        "found": _share([row.found_err_deg is not None and row.found_err_deg <= NEAR_DEG for row in rows]),
        "right_twin": _share([row.found_twin_ok for row in rows if row.found_twin_ok is not None]),
        "refined_med": _percentile(refined, 50),
        "refined_p90": _percentile(refined, 90),
        "in50_calm": _share([row.in50 for row in calm]),
        "in90_calm": _share([row.in90 for row in calm]),
        "in50_turbulent": _share([row.in50 for row in rough]),
        "in90_turbulent": _share([row.in90 for row in rough]),
        **{name: _percentile([getattr(row, name) for row in rows], 50) for name in _MEDIANS},
    }


def likelihood_document(
    machine: Mapping[str, Any], says: str, rows: Sequence[LikelihoodRow], absent: Mapping[str, str]
) -> dict[str, Any]:
    """The JSON: ``machine``, ``told``, ``rows``, ``overall``, ``absent``."""
    return {
        "machine": dict(machine),
        "told": says,
        "rows": [as_row(row) for row in rows],
        "overall": overall(rows),
        "absent": dict(absent),
    }


def as_row(row: LikelihoodRow) -> Row:
    """With the digits that mean something."""
    return {name: _rounded(value) if isinstance(value, float) else value for name, value in asdict(row).items()}


def frames_table(rows: Sequence[LikelihoodRow]) -> Table:
    """A line per frame."""
    table = Table(title="each frame", title_justify="left", box=SIMPLE_HEAD, pad_edge=False)
    names = _columns()
    for name in names:
        table.add_column(name.removesuffix("_nats").removesuffix("_deg"), justify="right", no_wrap=True)
    for row in map(as_row, rows):
        table.add_row(*(_cell(row[name]) for name in names))
    return table


def overall_table(total: Row, says: str) -> Table:
    """A line per figure."""
    table = Table(title=f"over all frames; {says}", title_justify="left", box=SIMPLE_HEAD, pad_edge=False)
    table.add_column("")
    table.add_column("", justify="right")
    table.add_column("")
    for name, value in total.items():
        table.add_row(name, _cell(value), MEANINGS[name])
    return table


def likelihood_page(command: str, document: Mapping[str, Any], sheets: Sequence[str]) -> str:
    """The page: machine, all frames, pictures, each frame."""
    total = [{"figure": name, "value": _cell(value), "": MEANINGS[name]} for name, value in document["overall"].items()]
    rows = [{name: _cell(value) for name, value in row.items()} for row in document["rows"]]
    parts = [
        "# Likelihood of a frame",
        f"`{command}`",
        f"Measured on: {machine_line(document['machine'])}.",
        f"## Over all frames\n\nWhat is {document['told']}.",
        markdown_table(total, ("figure", "value", "")),
        "## Pictures\n\nThe narrowest margin first. Residuals: red where the frame has more light, blue where less.",
        *(f"![frames]({name})" for name in sheets),
        "## Each frame",
        markdown_table(rows, _columns()),
    ]
    return "\n\n".join(parts) + "\n"


def _columns() -> tuple[str, ...]:
    return tuple(each.name for each in fields(LikelihoodRow))


def _share(values: Sequence[bool]) -> float | None:
    return round(sum(values) / len(values), 3) if values else None


def _percentile(values: Sequence[float], percent: float) -> float | None:
    return _rounded(float(np.percentile(values, percent))) if values else None


def _rounded(value: float | None) -> float | None:
    return None if value is None else float(f"{value:.4g}")


def _cell(value: Any) -> str:
    if value is None:
        return "-"
    if isinstance(value, bool):
        return "yes" if value else "no"
    return f"{value:g}" if isinstance(value, float) else str(value)

"""Figures of ``service.bench.misfits`` as JSON and tables."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from typing import Any

from rich.table import Table

from service.bench.misfits import KINDS, WITHIN, MisfitRow


def misfit_document(machine: Mapping[str, Any], rows: Sequence[MisfitRow]) -> dict[str, Any]:
    """Machine, rows, and per kind: how many, noticed in time, ``tracking`` in the last frame, share of frames."""
    overall = {kind: _overall([row for row in rows if row.kind == kind]) for kind in KINDS}
    return {
        "machine": machine,
        "rows": [asdict(row) for row in rows],
        "overall": {kind: one for kind, one in overall.items() if one["passes"]},
        "absent": {},
    }


def misfit_tables(document: Mapping[str, Any]) -> list[Table]:
    """One line a pass, and the totals."""
    single = Table(title="misfits")
    for name in ("kind", "case", "model", "from", "noticed after", "tracking", "wrong", "back after", "statuses"):
        single.add_column(name)
    for row in document["rows"]:
        words = " ".join(_SHORT.get(status, status) for status in row["statuses"])
        noticed = "never" if row["noticed_after"] is None else str(row["noticed_after"])
        facts = (row["kind"], row["case"], row["model"], str(row["from_frame"]), noticed, f"{row['tracking']:.2f}")
        back = "-" if row["back_after"] is None else str(row["back_after"])
        single.add_row(*facts, _told(row["wrong"]), back, words)
    total = Table(title=f"noticed: no_fit, lost or ambiguous within {WITHIN} frames")
    for name in (
        "kind",
        "passes",
        "noticed",
        "tracking at the end",
        "share of frames tracking",
        "and wrong",
        "back at once",
    ):
        total.add_column(name)
    for kind, one in document["overall"].items():
        shares = (f"{one[name]:.2f}" for name in ("noticed", "tracking_at_end", "tracking"))
        total.add_row(kind, str(one["passes"]), *shares, _told(one["wrong"]), _told(one["back_at_once"]))
    return [single, total]


def _told(share: float | None) -> str:
    return "-" if share is None else f"{share:.2f}"


_SHORT = {"tracking": "T", "acquiring": "a", "ambiguous": "A", "no_fit": "n", "lost": "l", "no_target": "0"}


def _overall(rows: Sequence[MisfitRow]) -> dict[str, float | None]:
    count, again = max(len(rows), 1), [row.back_after == 1 for row in rows if row.count is not None]
    wrong = [row.wrong for row in rows if row.wrong is not None]
    return {
        "passes": len(rows),
        "noticed": sum(row.in_time for row in rows) / count,
        "tracking_at_end": sum(row.last == "tracking" for row in rows) / count,
        "tracking": sum(row.tracking for row in rows) / count,
        "wrong": sum(wrong) / len(wrong) if wrong else None,
        "back_at_once": sum(again) / len(again) if again else None,
    }

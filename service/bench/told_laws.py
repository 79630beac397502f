"""What mode and joint benchmarks share: how often the right law was told, and whether probabilities hold."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from itertools import pairwise
from typing import Any, Protocol

import numpy as np
from rich.table import Table

from service.bench.tables import table_of

_SURE = 0.95
_BINS = (0.0, 0.6, 0.9, 0.99, 1.0)  # of what is told


class ToldLaw(Protocol):
    """One pass: a dataclass."""

    @property
    def truth(self) -> str:
        """The law that it was drawn from."""

    @property
    def told(self) -> str:
        """The most probable one."""

    @property
    def probability(self) -> float:
        """Of what is told."""

    @property
    def seconds(self) -> float:
        """Of an answer."""


def line_of(title: str, name: str, rows: Sequence[ToldLaw]) -> dict[str, Any]:
    """How often the passes of a law were told rightly, and with what probability. ``title``: of the name's column."""
    right, p = _right(rows), _told(rows)
    sure = p >= _SURE
    return {
        title: name,
        "passes": len(rows),
        "right": float(right.mean()),
        "told_p": float(p.mean()),
        "sure": float(sure.mean()),
        "sure_right": float(right[sure].mean()) if sure.any() else None,
        "seconds_med": float(np.median([row.seconds for row in rows])),
    }


def reliability(rows: Sequence[ToldLaw]) -> list[dict[str, Any]]:
    """Of the passes told with a probability in a bin: its mean, and the share that was right."""
    right, p = _right(rows), _told(rows)
    lines: list[dict[str, Any]] = []
    for low, high in pairwise(_BINS):
        mine = (p >= low) & ((p < high) | (high == _BINS[-1]))
        if mine.any():
            told = {"told_p": float(p[mine].mean()), "right": float(right[mine].mean())}
            lines.append({"from": low, "to": high, "passes": int(mine.sum()), **told})
    return lines


def told_document(
    machine: Mapping[str, Any], rows: Sequence[ToldLaw], overall: Sequence[Mapping[str, Any]]
) -> dict[str, Any]:
    """The JSON: rows, a line of each law and of all, reliability."""
    told = [asdict(row) for row in rows]  # type: ignore[call-overload]  # a Protocol cannot ask for a dataclass
    return {
        "machine": dict(machine),
        "rows": told,
        "overall": list(overall),
        "reliability": reliability(rows),
        "absent": {},
    }


def told_tables(title: str, document: Mapping[str, Any]) -> tuple[Table, Table]:
    """The lines of ``told_document``."""
    return table_of(title, document["overall"]), table_of("reliability", document["reliability"])


def _right(rows: Sequence[ToldLaw]) -> np.ndarray[Any, np.dtype[np.bool_]]:
    return np.array([row.told == row.truth for row in rows])


def _told(rows: Sequence[ToldLaw]) -> np.ndarray[Any, np.dtype[np.float64]]:
    return np.array([row.probability for row in rows])

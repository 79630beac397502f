"""What is known of an object over its passes, as one HTML file."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime
from typing import Any

import numpy as np

from service.inference.state import Array
from service.report.charts import Line, chart
from service.report.curves import Chart, on_sphere_deg
from service.report.sentences import SEEN_SIGMAS, turning_sentence, with_sigma
from service.report.templating import template

Document = Mapping[str, Any]
_DAY_S = 86_400.0
_BLUE, _INK, _RED = "#2166ac", "#1c232b", "#b2182b"
_POINTS = 60  # of the fitted line


@dataclass(frozen=True)
class ObjectFacts:
    """All that it tells, as the API tells it."""

    tracked: Document
    passes: Sequence[Document]  # in order of time
    spin: Document | None
    why_no_spin: str  # where there is none
    left_out: Sequence[Document]  # passes that tell nothing of it, each with its reason
    motion: Document | None  # of the last pass
    why_no_motion: str
    version: str
    made_at: str


def object_html(facts: ObjectFacts) -> bytes:
    """The file."""
    spin = facts.spin
    page = template("object.html").render(
        facts=facts,
        spin=spin,
        sentences=(spin_sentence(spin, facts.why_no_spin), last_sentence(facts.motion, facts.why_no_motion)),
        places={one["pass"]: on_sphere_deg(_vector(one["axis_gcrf"])) for one in spin["passes"]} if spin else {},
        charts=[] if spin is None else [_periods(spin), *_axes(spin)],
    )
    return page.encode()


def spin_sentence(spin: Document | None, why_not: str) -> str:
    """How it spins over its passes; ``why_not`` where that is not known."""
    if spin is None:
        return f"How it spins over its passes is not known: {why_not}."
    ra, dec = on_sphere_deg(_vector(spin["axis_gcrf"]))
    period = with_sigma(spin["period_s"], spin["period_sigma_s"])
    told = f"It turns once in {period} s, about right ascension {ra:.1f}°, declination {dec:+.1f}°"
    change, sigma = 1e3 * spin["period_change_s_per_day"], 1e3 * spin["period_change_sigma_s_per_day"]
    if abs(change) < SEEN_SIGMAS * sigma:
        return f"{told}; no change of the period is seen ({with_sigma(change, sigma)} ms a day)."
    return f"{told}, {'slower' if change > 0 else 'faster'} by {with_sigma(abs(change), sigma)} ms a day."


def last_sentence(motion: Document | None, why_not: str) -> str:
    """The motion of the last pass."""
    told = turning_sentence(motion, why_not)
    return f"In its last pass: {told[0].lower()}{told[1:]}"


def _periods(spin: Document) -> Chart:
    """Each pass, and the line through all: what they are beyond the period that is told."""
    days, fitted = _days(spin)
    level = float(spin["period_s"])
    line = level + float(spin["period_change_s_per_day"]) * fitted
    wide = np.hypot(spin["period_sigma_s"], float(spin["period_change_sigma_s_per_day"]) * fitted)
    at = np.searchsorted(days, _times(spin))
    values, sigmas = np.full(len(days), np.nan), np.zeros(len(days))
    values[at] = [one["period_s"] - level for one in spin["passes"]]
    sigmas[at] = [one["period_sigma_s"] for one in spin["passes"]]
    lines = [Line("all passes", _BLUE, line - level, wide), Line("each pass alone", _INK, values, sigmas)]
    return _chart(f"Period beyond {level:.6g} s, s", days, lines)


def _axes(spin: Document) -> list[Chart]:
    """Where the axis points in each pass, and as all of them tell it."""
    days, _ = _days(spin)
    at = np.searchsorted(days, _times(spin))
    each = on_sphere_deg(np.array([_vector(one["axis_gcrf"]) for one in spin["passes"]]))
    whole = on_sphere_deg(_vector(spin["axis_gcrf"]))
    each[:, 0] = whole[0] + (each[:, 0] - whole[0] + 180) % 360 - 180
    out = []
    for k, name in enumerate(("Right ascension", "Declination")):
        values = np.full(len(days), np.nan)
        values[at] = each[:, k]
        lines = [Line("all passes", _BLUE, np.full(len(days), whole[k])), Line("each pass alone", _RED, values)]
        out.append(_chart(f"{name} of the axis, deg", days, lines))
    return out


def _days(spin: Document) -> tuple[Array, Array]:
    """Places of the charts: days from the first pass, and from the middle to which the spin is told."""
    times = _times(spin)
    line = np.linspace(times[0], times[-1], _POINTS)
    days = np.union1d(line, times)
    middle = _since(spin["passes"][0]["epoch"], spin["epoch"])
    return days, days - middle


def _times(spin: Document) -> Array:
    first = spin["passes"][0]["epoch"]
    return np.array([_since(first, one["epoch"]) for one in spin["passes"]])


def _since(first: str, then: str) -> float:
    """Days."""
    return (datetime.fromisoformat(then) - datetime.fromisoformat(first)).total_seconds() / _DAY_S


def _vector(named: Mapping[str, float]) -> Array:
    return np.array([named[name] for name in "xyz"])


def _chart(title: str, days: Array, lines: Sequence[Line]) -> Chart:
    keys = tuple((line.colour, line.name) for line in lines)
    return Chart(title, keys, chart(f"{title}, over days", days, lines))

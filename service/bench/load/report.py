"""What ``skypose bench load`` shows: the rows as JSON, capacities and costs as tables, latency as a plot."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from textwrap import fill
from typing import TYPE_CHECKING, Any

from rich.box import MARKDOWN
from rich.table import Table

from service.bench.load.plan import LoadPlan, LoadRow
from service.bench.load.search import capacities
from service.bench.plotting import require_matplotlib
from service.bench.scorer_report import LINE

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_KEY = ("engine", "workers", "particles", "rate_hz")


def load_document(machine: Mapping[str, Any], plan: LoadPlan, rows: Sequence[LoadRow]) -> dict[str, Any]:
    """The JSON: every measurement in ``rows``, what was carried in ``capacity``, with the gain of more workers."""
    held = [{**_plain(row), "speedup": speedup(row, rows)} for row in capacities(rows)]
    return {
        "machine": dict(machine),
        "bound_ms": plan.bound_ms,
        "seconds": plan.seconds,
        "rows": [_plain(row) for row in rows],
        "capacity": held,
        "absent": {},
    }


def speedup(row: LoadRow, rows: Sequence[LoadRow]) -> float | None:
    """Frames per second over those that one worker carried at the same particles and rate; None without one."""
    alone = [
        other.frames_per_s
        for other in capacities(rows)
        if (other.engine, other.workers, other.particles, other.rate_hz) == (row.engine, 1, row.particles, row.rate_hz)
    ]
    return _short(row.frames_per_s / alone[0]) if alone else None


def _plain(row: LoadRow) -> dict[str, Any]:
    flat = asdict(row)
    cost = flat.pop("cost")
    return {name: _short(value) for name, value in {**flat, **cost}.items()}


def _short(value: Any) -> Any:
    """Four digits; no number where there was no answer to take the time of."""
    if not isinstance(value, float):
        return value
    return float(f"{value:.4g}") if value != float("inf") else None


def row_line(row: LoadRow) -> str:
    """A measurement as it is told while the others go on."""
    verdict = "held" if row.held else "too much"
    return (
        f"{row.engine}, workers {row.workers}, {row.particles} particles, {row.sessions} sessions at "
        f"{row.rate_hz:g}/s: {row.frames_per_s:.1f} frames/s, p50 {row.p50_ms:.0f} ms, p99 {row.p99_ms:.0f} ms, "
        f"late {row.late}, refused {row.refused}: {verdict}"
    )


def capacity_table(plan: LoadPlan, rows: Sequence[LoadRow]) -> Table:
    """The most that was carried, and its gain over one worker."""
    title = f"most sessions with p99 under {plan.bound_ms:g} ms"
    table = _table(title, ("frames/s", "p50 ms", "p99 ms", "x one worker"))
    for row in capacities(rows):
        gain = speedup(row, rows)
        table.add_row(
            *_names(row), f"{row.frames_per_s:.1f}", f"{row.p50_ms:.0f}", f"{row.p99_ms:.0f}", _figure(gain, "{:.2f}")
        )
    return table


def cost_table(rows: Sequence[LoadRow]) -> Table:
    """What a frame cost in those measurements."""
    heads = ("web ms", "workers ms", "clients ms", "rows", "database kB", "log kB", "sent kB", "received kB")
    table = _table("per frame: computing time, rows, bytes", heads)
    for row in capacities(rows):
        cost = row.cost
        times = (_figure(value, "{:.1f}") for value in (cost.web_cpu_ms, cost.worker_cpu_ms, cost.client_cpu_ms))
        sizes = (cost.database_bytes, cost.log_bytes, cost.sent_bytes, cost.received_bytes)
        kilobytes = (_figure(None if value is None else value / 1e3, "{:.1f}") for value in sizes)
        table.add_row(*_names(row), *times, _figure(cost.rows, "{:.1f}"), *kilobytes)
    return table


def _table(title: str, heads: Sequence[str]) -> Table:
    table = Table(title=title, title_justify="left", box=MARKDOWN)
    table.add_column("engine", no_wrap=True)
    for name in ("workers", "particles", "frames/s each", "sessions", *heads):
        table.add_column(name, justify="right", no_wrap=True)
    return table


def _names(row: LoadRow) -> tuple[str, ...]:
    return row.engine, str(row.workers), f"{row.particles:,}", f"{row.rate_hz:g}", str(row.sessions)


def _figure(value: float | None, form: str) -> str:
    return "-" if value is None else form.format(value)


def load_plot(rows: Sequence[LoadRow], bound_ms: float, caption: str) -> Figure:
    """The 99th percentile against the frames per second that were sent. Raises ``PlotsMissingError``."""
    require_matplotlib()
    from matplotlib.figure import Figure

    plot = Figure(figsize=(7.0, 4.2), layout="constrained")
    panel = plot.subplots()
    for colour, key in enumerate(dict.fromkeys(tuple(getattr(row, name) for name in _KEY) for row in rows)):
        mine = sorted(
            (row for row in rows if tuple(getattr(row, name) for name in _KEY) == key and row.p99_ms != float("inf")),
            key=lambda row: row.sessions,
        )
        engine, workers, particles, rate_hz = key
        label = f"{engine}, workers {workers}, {particles:,} particles, {rate_hz:g} frames/s each"
        x = [row.sessions * row.rate_hz for row in mine]
        panel.plot(x, [row.p99_ms for row in mine], "o-", color=f"C{colour}", label=label, linewidth=1.4)
        panel.plot(x, [row.p50_ms for row in mine], ":", color=f"C{colour}", linewidth=1.2)
    panel.plot([], [], ":", color="grey", label="median")
    panel.axhline(bound_ms, color="grey", linewidth=0.8)
    panel.set(xscale="log", yscale="log", xlabel="frames per second sent", ylabel="ms from due to answered, p99")
    panel.grid(linewidth=0.3)
    panel.legend(fontsize=8)
    plot.suptitle(fill(caption, LINE, break_on_hyphens=False), fontsize=7)
    return plot

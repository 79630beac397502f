"""What ``skypose bench step`` shows: the rows as JSON, as a table and as a plot."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from textwrap import fill
from typing import TYPE_CHECKING, Any

from rich.box import MARKDOWN
from rich.table import Table

from service.bench.plotting import require_matplotlib
from service.bench.scorer_report import LINE, figure
from service.bench.step_bench import StepFigures, StepRow

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def step_document(machine: Mapping[str, Any], figures: StepFigures) -> dict[str, Any]:
    """The JSON: ``rows``, and ``absent`` (contestant -> why it has none)."""
    rows = [
        {key: float(f"{value:.4g}") if isinstance(value, float) else value for key, value in asdict(row).items()}
        for row in figures.rows
    ]
    return {"machine": dict(machine), "rows": rows, "absent": dict(figures.absent)}


def step_table(figures: StepFigures) -> Table:
    """A line per contestant and number of particles."""
    table = Table(title="a whole step", title_justify="left", box=MARKDOWN)
    for name in ("backend", "step"):
        table.add_column(name, no_wrap=True)
    for name in ("particles", "px", "faces", "step ms", "score ms", "scoring", "peak MiB"):
        table.add_column(name, justify="right", no_wrap=True)
    for row in figures.rows:
        peak = "-" if row.peak_mib is None else f"{row.peak_mib:.0f}"
        times = figure(row.step_ms), figure(row.score_ms), f"{row.score_share:.0%}"
        table.add_row(row.backend, row.step, f"{row.particles:,}", str(row.size_px), f"{row.faces:,}", *times, peak)
    return table


def step_plot(rows: Sequence[StepRow], caption: str) -> Figure:
    """Milliseconds per step against the number of particles, and the scoring in it. Raises ``PlotsMissingError``."""
    require_matplotlib()
    from matplotlib.figure import Figure

    plot = Figure(figsize=(7.0, 4.2), layout="constrained")
    panel = plot.subplots()
    for colour, name in enumerate(dict.fromkeys((row.backend, row.step) for row in rows)):
        mine = [row for row in rows if (row.backend, row.step) == name]
        x = [row.particles for row in mine]
        panel.plot(x, [row.step_ms for row in mine], "o-", color=f"C{colour}", label=", ".join(name), linewidth=1.4)
        panel.plot(x, [row.score_ms for row in mine], ":", color=f"C{colour}", linewidth=1.2)
    panel.plot([], [], ":", color="grey", label="of it scoring")
    panel.set(xscale="log", yscale="log", xlabel="particles", ylabel="ms per step")
    panel.grid(linewidth=0.3)
    panel.legend(fontsize=8)
    plot.suptitle(fill(caption, LINE, break_on_hyphens=False), fontsize=7)
    return plot

"""What ``skypose bench scorers`` shows: the rows as JSON, as a table and as a plot, with the paper's beside them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from textwrap import fill
from typing import TYPE_CHECKING, Any

from rich.box import MARKDOWN
from rich.table import Table

from gpu.bench import ScorerFigures, ScorerRow
from service.bench.plotting import require_matplotlib

if TYPE_CHECKING:
    from matplotlib.figure import Figure

LINE = 100  # characters of a plot's caption
PAPER: tuple[
    Mapping[str, Any], ...
] = (  # Fig. 2 of arXiv:1906.11182, per particle; machine, mesh and image are those of the paper
    {"backend": "paper: one CPU thread", "us_per_particle": 11_700.0},
    {"backend": "paper: many CPU threads", "us_per_particle": 5_400.0},
    {"backend": "paper: OpenGL + OpenCL", "us_per_particle": 1_200.0},
)


def scorer_document(machine: Mapping[str, Any], figures: ScorerFigures) -> dict[str, Any]:
    """The JSON: ``rows``, ``absent`` (backend -> why it has none) and ``paper``."""
    rows = [
        {key: float(f"{value:.4g}") if isinstance(value, float) else value for key, value in asdict(row).items()}
        for row in figures.rows
    ]
    return {"machine": dict(machine), "rows": rows, "absent": dict(figures.absent), "paper": list(PAPER)}


def scorer_table(figures: ScorerFigures) -> Table:
    """Microseconds per particle: a line per mesh and size, a column per backend."""
    names = list(dict.fromkeys(row.backend for row in figures.rows))
    table = Table(title="µs per particle", title_justify="left", box=MARKDOWN)
    for name in ("faces", "px", *names):
        table.add_column(name, justify="right", no_wrap=True)
    for faces, size_px in dict.fromkeys((row.faces, row.size_px) for row in figures.rows):
        cells = {r.backend: figure(r.us_per_particle) for r in figures.rows if (r.faces, r.size_px) == (faces, size_px)}
        table.add_row(f"{faces:,}", str(size_px), *(cells.get(name, "-") for name in names))
    return table


def agreement_table(figures: ScorerFigures) -> Table:
    """The greatest difference to the reference, over all meshes and sizes."""
    table = Table(title="agreement with the reference", title_justify="left", box=MARKDOWN)
    for name in ("backend", "device", "relative to the score", "relative to its edge", "agrees"):
        table.add_column(name)
    for name in dict.fromkeys(row.backend for row in figures.rows):
        mine = [row for row in figures.rows if row.backend == name]
        worst, edge = max(row.max_rel_error for row in mine), max(row.edge_error for row in mine)
        agrees = "yes" if all(row.agrees for row in mine) else "no"
        table.add_row(name, mine[0].device, f"{worst:.1e}", f"{edge:.1e}", agrees)
    return table


def paper_line() -> str:
    """The paper's row."""
    figures = ", ".join(f"{figure(row['us_per_particle'])} ({row['backend'].removeprefix('paper: ')})" for row in PAPER)
    return f"The paper's own, µs per particle, on its machine: {figures}."


def figure(value: float) -> str:
    """Three digits, without an exponent."""
    digits = f"{value:.3g}"
    return f"{float(digits):,.0f}" if value >= 100 else digits


def scorer_plot(rows: Sequence[ScorerRow], caption: str) -> Figure:
    """Microseconds per particle against the image's side: a panel per mesh. Raises ``PlotsMissingError``."""
    require_matplotlib()
    from matplotlib.figure import Figure

    faces = list(dict.fromkeys(row.faces for row in rows))
    names = list(dict.fromkeys(row.backend for row in rows))
    plot = Figure(figsize=(4.0 * len(faces) + 1.6, 4.2), layout="constrained")
    axes: Any = plot.subplots(1, len(faces), squeeze=False, sharey=True)
    for panel, count in zip(axes[0], faces, strict=True):
        for colour, name in enumerate(names):
            mine = [row for row in rows if (row.faces, row.backend) == (count, name)]
            x, y = [row.size_px for row in mine], [row.us_per_particle for row in mine]
            panel.plot(x, y, "o-", color=f"C{colour}", label=name, linewidth=1.4, markersize=4)
        for style, row in zip(("-", "--", ":"), PAPER, strict=True):
            panel.axhline(row["us_per_particle"], color="grey", linestyle=style, linewidth=0.9, label=row["backend"])
        sizes = sorted({row.size_px for row in rows})
        panel.set(xscale="log", yscale="log", title=f"{count:,} faces", xlabel="image side, px")
        panel.set_xticks(sizes, [str(size) for size in sizes])
        panel.minorticks_off()
        panel.grid(axis="y", linewidth=0.3)
    axes[0][0].set_ylabel("µs per particle")
    axes[0][-1].legend(fontsize=8, loc="center left", bbox_to_anchor=(1.0, 0.5))
    plot.suptitle(fill(caption, LINE, break_on_hyphens=False), fontsize=7)
    return plot

"""What the scorer and step benchmarks share: the machine, the tables, JSON, a plot, and refusals in a line."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from rich.table import Table

_FILE_WIDTH = 200


def publish(
    document: Mapping[str, Any],
    tables: Sequence[Table | str],
    draw: Callable[[str], Figure] | None,
    json: Path | None,
    plot: Path | None,
) -> None:
    """Print machine and tables, and write what was asked for. ``draw`` makes the plot under a caption."""
    import orjson
    from rich.console import Console

    from service.bench.machine import machine_line

    console = Console()
    if not console.is_terminal:  # a file has no width: columns are not cut short
        console = Console(width=_FILE_WIDTH)
    caption = machine_line(document["machine"])
    console.print(f"Measured on: {caption}.", highlight=False)
    for table in tables:
        console.print("", table, sep="\n", highlight=False)
    for name, reason in document["absent"].items():
        console.print(f"{name}: not measured: {reason}", highlight=False)
    if json is not None:
        json.write_bytes(orjson.dumps(document, option=orjson.OPT_INDENT_2))
    if draw is not None and plot is not None:
        draw(caption).savefig(plot, dpi=110)


@contextmanager
def told(plot: Path | None) -> Iterator[None]:
    """What a user can mend is told in a line; a plot that cannot be drawn, before anything is measured."""
    from gpu.errors import ScorerError
    from service.bench.plotting import PlotsMissingError, require_matplotlib

    try:
        if plot is not None:
            require_matplotlib()
        yield
    except (ScorerError, PlotsMissingError) as error:
        typer.secho(str(error), fg="red", err=True)
        raise typer.Exit(1) from error

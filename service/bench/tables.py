"""Lines of a benchmark's summary as a table that Markdown reads."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from rich.box import MARKDOWN
from rich.table import Table


def table_of(title: str, lines: Sequence[Mapping[str, Any]]) -> Table:
    """A row for each line, columns as the first line has them; None is told as a dash."""
    table = Table(title=title, title_justify="left", box=MARKDOWN)
    for name in lines[0]:
        table.add_column(name, justify="right")
    for line in lines:
        table.add_row(*(f"{v:.3g}" if isinstance(v, float) else "-" if v is None else str(v) for v in line.values()))
    return table

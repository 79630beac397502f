"""``skypose bench sky``: what learning a sky costs by the size of the image."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def sky(
    json: Annotated[Path | None, typer.Option("--json", help="Write the rows as JSON.")] = None,
    side: Annotated[
        list[int] | None,
        typer.Option(min=64, max=8192, help="Of the image, px; may be repeated. Default: 256 to 2048."),
    ] = None,
    frames: Annotated[
        list[int] | None,
        typer.Option(min=0, max=16, help="Empty frames; 0: one that shows the body. May be repeated. Default: 0, 5."),
    ] = None,
    repeats: Annotated[int, typer.Option(min=1, help="Of which the medians are told.")] = 5,
) -> None:
    """Time to learn a sky from frames that are decoded, and its error, by the size of the image."""
    from service.bench.machine import describe_machine
    from service.bench.sky_bench import bench_sky, sky_document, sky_table
    from service.cli.bench_output import publish

    rows = bench_sky(side or (256, 600, 1024, 2048), frames or (0, 5), repeats, lambda line: typer.echo(line, err=True))
    publish(sky_document(describe_machine(), rows), (sky_table(rows),), None, json, None)

"""``skypose bench engines``: frames per second of many sessions, by engine and number of workers."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import typer

Preset = Literal["balanced", "paper"]


def engines(
    json: Annotated[Path | None, typer.Option("--json", help="Write the rows as JSON.")] = None,
    workers: Annotated[list[int] | None, typer.Option(min=1, help="May be repeated. Default: 1 and 2.")] = None,
    sessions: Annotated[int, typer.Option(min=1, help="At once.")] = 16,
    particles: Annotated[int, typer.Option(min=1, help="Of each session.")] = 500,
    size: Annotated[int, typer.Option(min=16, help="Image side, px.")] = 256,
    frames: Annotated[int, typer.Option(min=1, help="Of each session in a round.")] = 5,
    rounds: Annotated[int, typer.Option(min=2, help="Of all engines in turn; the first is not counted.")] = 5,
    engine: Annotated[Literal["process", "ray"], typer.Option(help="ray: an actor too, one by one.")] = "process",
    preset: Annotated[Preset, typer.Option(help="Of the sessions.")] = "balanced",
) -> None:
    """Sessions over worker processes: one by one, all at once. No HTTP and no database."""
    import asyncio
    from dataclasses import asdict

    from service.bench.engine_bench import EnginePlan, bench_engines, engines_table, process_contestants, ray_contestant
    from service.bench.machine import describe_machine
    from service.cli.bench_output import publish

    plan = EnginePlan(sessions, particles, size, frames, rounds, preset)
    entries = [*process_contestants(workers or [1, 2]), *([ray_contestant()] if engine == "ray" else [])]
    rows = asyncio.run(bench_engines(entries, plan, lambda line: typer.echo(line, err=True)))
    document = {"machine": describe_machine(), "rows": [asdict(row) for row in rows], "absent": {}}
    publish(document, (engines_table(rows),), None, json, None)

"""``skypose bench scorers``: microseconds per particle of every backend, on this machine."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

Json = Annotated[Path | None, typer.Option("--json", help="Write the rows as JSON.")]
Plot = Annotated[Path | None, typer.Option("--plot", help="Write a plot (PNG, SVG or PDF).")]
Quick = Annotated[bool, typer.Option("--quick", help="Short calls, few repeats: a look, not a measurement.")]
Backends = Annotated[list[str] | None, typer.Option("--backend", help="Only this one; may be repeated.")]
MeshFiles = Annotated[list[str] | None, typer.Option("--mesh", help="Mesh file instead of made-up bodies; repeatable.")]


def scorers(
    json: Json = None,
    plot: Plot = None,
    quick: Quick = False,
    backend: Backends = None,
    mesh: MeshFiles = None,
    size: Annotated[list[int] | None, typer.Option(min=16, max=8191, help="Image side, px; may be repeated.")] = None,
    faces: Annotated[list[int] | None, typer.Option(min=1, help="Of a made-up body; may be repeated.")] = None,
    seed: Annotated[int, typer.Option(min=0, help="Of the particles.")] = 0,
) -> None:
    """Time per particle of every scorer, side by side in one run, and agreement with the reference."""
    from dataclasses import replace
    from functools import partial

    from gpu.bench import QUICK, Plan, bench_scorers, contestants
    from service.bench.bodies import FACES, body_of
    from service.bench.machine import describe_machine
    from service.bench.opencv_loop import NAME, opencv_contestant
    from service.bench.scorer_report import agreement_table, paper_line, scorer_document, scorer_plot, scorer_table
    from service.cli.bench_output import publish, told
    from service.cli.model_file import read_model_file

    with told(plot):
        wanted = backend or [*(entry.name for entry in contestants()), NAME]
        entries = contestants([name for name in wanted if name != NAME])
        entries += [opencv_contestant()] if NAME in wanted else []
        bodies = [read_model_file(name).mesh for name in mesh] if mesh else [body_of(n) for n in faces or FACES]
        plan = replace(QUICK if quick else Plan(), seed=seed)
        plan = replace(plan, sizes_px=tuple(size)) if size else plan
        figures = bench_scorers(entries, bodies, plan, lambda line: typer.echo(line, err=True))
        tables = (scorer_table(figures), agreement_table(figures), paper_line())
        publish(scorer_document(describe_machine(), figures), tables, partial(scorer_plot, figures.rows), json, plot)
    raise typer.Exit(0 if figures.rows and all(row.agrees for row in figures.rows) else 1)

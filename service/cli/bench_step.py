"""``skypose bench step``: a whole step of the filter, on this machine."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def step(
    json: Annotated[Path | None, typer.Option("--json", help="Write the rows as JSON.")] = None,
    plot: Annotated[Path | None, typer.Option("--plot", help="Write a plot (PNG, SVG or PDF).")] = None,
    quick: Annotated[
        bool, typer.Option("--quick", help="Few repeats, no long steps: a look, not a measurement.")
    ] = False,
    backend: Annotated[list[str] | None, typer.Option("--backend", help="Only this one; may be repeated.")] = None,
    particles: Annotated[list[int] | None, typer.Option(min=1, max=10_000_000, help="May be repeated.")] = None,
    size: Annotated[int, typer.Option(min=16, max=8191, help="Image side, px.")] = 512,
    faces: Annotated[int, typer.Option(min=1, help="Of a made-up body.")] = 7_000,
    seed: Annotated[int, typer.Option(min=0, help="Of the pose and the particles.")] = 0,
) -> None:
    """Time of a whole step, from resampling to the estimate, and the scorer's share of it."""
    from dataclasses import replace
    from functools import partial

    from service.bench.bodies import body_of
    from service.bench.machine import describe_machine
    from service.bench.step_bench import QUICK, StepPlan, bench_step, step_contestants
    from service.bench.step_report import step_document, step_plot, step_table
    from service.cli.bench_output import publish, told

    with told(plot):
        plan = replace(QUICK if quick else StepPlan(), size_px=size, seed=seed)
        plan = replace(plan, particles=tuple(sorted(particles))) if particles else plan
        entries = step_contestants(backend or ())
        figures = bench_step(entries, body_of(faces), plan, lambda line: typer.echo(line, err=True))
        document = step_document(describe_machine(), figures)
        publish(document, (step_table(figures),), partial(step_plot, figures.rows), json, plot)
    raise typer.Exit(0 if figures.rows else 1)

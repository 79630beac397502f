"""``skypose bench misfits``: whether the filter notices frames that its model does not explain."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def misfits(
    folder: Annotated[Path, typer.Argument(help="Folder of sequences.")],
    kind: Annotated[
        list[str] | None, typer.Option(help="mesh, mirror, cloud, bird, trail; may be repeated. Default: all.")
    ] = None,
    case: Annotated[list[str] | None, typer.Option("--case", help="Only this sequence; may be repeated.")] = None,
    limit: Annotated[int | None, typer.Option(min=2, help="Only so many frames of each pass.")] = None,
    spoilt: Annotated[
        int | None, typer.Option(min=1, help="Only so many frames are spoilt, from the sixth on.")
    ] = None,
    bodies: Annotated[int, typer.Option(min=2, help="Whose frames are followed with each other's mesh.")] = 6,
    json: Annotated[Path | None, typer.Option("--json", help="Write the rows as JSON.")] = None,
    meshes: Annotated[Path | None, typer.Option("--meshes", help="Where the sequences' meshes lie.")] = None,
    settings: Annotated[list[str] | None, typer.Option("--set", help="SECTION.NAME=VALUE for all sessions.")] = None,
) -> None:
    """Another body's frames, frames mirrored mid-pass, a cloud, a bird, a satellite's trail before it: is it said?"""
    from service.bench.cases import ModelShelf
    from service.bench.folder import find_sequences
    from service.bench.machine import describe_machine
    from service.bench.misfit_report import misfit_document, misfit_tables
    from service.bench.misfits import BEFORE, KINDS, SPOILT, Misfit, run_misfit, wrong_meshes
    from service.bench.runner import Terms
    from service.cli.bench import refusals
    from service.cli.bench_output import publish, told
    from service.cli.bench_run import bench_progress, entries_of
    from service.workers.tracker import Tracker

    kinds = tuple(kind or KINDS)
    if not set(kinds) <= set(KINDS):
        raise typer.BadParameter(f"{', '.join(kinds)}: there are {', '.join(KINDS)}")
    rows, tracker = [], Tracker()
    try:
        with refusals(), told(None), bench_progress() as progress:
            entry, shelf = entries_of(["balanced"], settings or ())[0], ModelShelf(tracker)
            cases = [one.case(shelf) for one in find_sequences(folder, tuple(case or ()), meshes)]
            chosen: list[Misfit] = list(wrong_meshes(cases, bodies)) if "mesh" in kinds else []
            for one in cases:
                count = sum(1 for _ in one.frames()) if limit is None else limit
                first = count // 2 if spoilt is None else min(BEFORE, count // 2)
                chosen += [spoil(one, first, spoilt) for name, spoil in SPOILT.items() if name in kinds]
            task = progress.add_task("", total=len(chosen))
            for misfit in chosen:
                rows.append(run_misfit(tracker, misfit, entry, Terms(limit)))
                progress.update(task, advance=1, description=f"{misfit.kind} {misfit.case.name}")
    finally:
        tracker.close()
        if rows:
            document = misfit_document(describe_machine(), rows)
            publish(document, misfit_tables(document), None, json, None)

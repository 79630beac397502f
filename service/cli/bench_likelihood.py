"""``skypose bench likelihood``: whether the light of single frames prefers the truth, and how sure it is."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from service.bench.likelihood import LikelihoodPlan, Looked
    from service.cli.bench_run import Selection

_MOST_PRINTED = 120  # rows; of more only the totals


def likelihood(
    folder: Annotated[Path | None, typer.Argument(help="Folder of sequences, or one sequence.")] = None,
    frames: Annotated[str, typer.Option(help="Of each pass: numbers with commas.")] = "0,5,10",
    case: Annotated[list[str] | None, typer.Option("--case", help="Only this sequence; may be repeated.")] = None,
    limit: Annotated[int | None, typer.Option(min=1, help="Only among so many frames of each pass.")] = None,
    json: Annotated[Path | None, typer.Option("--json", help="Write the rows as JSON.")] = None,
    report: Annotated[Path | None, typer.Option(help="Folder for report.md and pictures of every frame.")] = None,
    nosun: Annotated[bool, typer.Option("--nosun", help="Do not tell where the Sun stands.")] = False,
    sun_off: Annotated[float, typer.Option(help="Tell it wrongly, by so many degrees.")] = 0.0,
    sun_sigma: Annotated[float, typer.Option(min=0.01, help="Degrees to which it is told.")] = 1.0,
    known_range: Annotated[bool, typer.Option("--range", help="Tell the scale as a range gives it.")] = False,
    passes: Annotated[int, typer.Option(min=0, help="Instead of a folder: so many simulated passes.")] = 0,
    seed: Annotated[int, typer.Option(min=0, help="Of the simulated passes.")] = 0,
    mesh: Annotated[list[str] | None, typer.Option("--mesh", help="Of simulated passes; may be repeated.")] = None,
    materials: Annotated[str | None, typer.Option(help="Of simulated passes: painted, or mixed.")] = None,
    meshes: Annotated[Path | None, typer.Option("--meshes", help="Where the sequences' meshes lie.")] = None,
) -> None:
    """Single frames with known truth: does the light prefer it, is it found, does its refinement know its error."""
    from service.bench.likelihood import LikelihoodPlan
    from service.bench.told import Told
    from service.cli.bench import refusals
    from service.cli.bench_output import told
    from service.cli.bench_run import Selection

    bodies, names = tuple(mesh or ()), tuple(case or ())
    plan = LikelihoodPlan(Told(not nosun, sun_off, known_range), sun_sigma, _numbers(frames), limit)
    with refusals(), told(None):
        longest = max(plan.wanted, default=0) + 1
        chosen = Selection(folder, names, meshes, passes, seed, bodies, None, None, longest, materials)
        _run(chosen, plan, json, report)


def _numbers(text: str) -> tuple[int, ...]:
    try:
        found = tuple(int(part) for part in text.split(","))
    except ValueError:
        found = (-1,)
    if min(found) < 0:
        raise typer.BadParameter(f"{text!r} is not a list of frame numbers, such as 0,5,10")
    return found


def _run(selection: Selection, plan: LikelihoodPlan, json: Path | None, report: Path | None) -> None:
    """Run, print, write. What was measured before an interruption is written too."""
    from service.bench.cases import ModelShelf
    from service.bench.likelihood import bench_case
    from service.bench.likelihood_report import frames_table, likelihood_document, overall_table
    from service.bench.machine import describe_machine
    from service.cli.bench_output import publish
    from service.cli.bench_run import bench_progress
    from service.workers.tracker import Tracker

    looked: list[Looked] = []
    absent: dict[str, str] = {}
    tracker = Tracker()
    try:
        with bench_progress() as progress:
            task = progress.add_task("", total=selection.count)
            for case in selection.cases(ModelShelf(tracker)):

                def say(frame: int, name: str = case.name) -> None:
                    progress.update(task, description=f"{name}: frame {frame}")

                looked += bench_case(tracker, case, plan, say, absent)
                progress.update(task, advance=1)
    finally:
        tracker.close()
        rows = [one.row for one in looked]
        if rows:
            document = likelihood_document(describe_machine(), plan.says, rows, absent)
            tables = [overall_table(document["overall"], plan.says)]
            tables = [frames_table(rows), *tables] if len(rows) <= _MOST_PRINTED else tables
            publish(document, tables, None, json, None)
            if report is not None:
                _write_report(report, looked, document)


def _write_report(folder: Path, looked: Sequence[Looked], document: Mapping[str, Any]) -> None:
    import orjson

    from service.bench.likelihood_pictures import contact_sheets
    from service.bench.likelihood_report import likelihood_page
    from service.cli.bench import command_line

    folder.mkdir(parents=True, exist_ok=True)
    (folder / "rows.json").write_bytes(orjson.dumps(document, option=orjson.OPT_INDENT_2))
    sheets = dict(contact_sheets(looked))
    for name, data in sheets.items():
        (folder / name).write_bytes(data)
    (folder / "report.md").write_text(likelihood_page(command_line(), document, list(sheets)))

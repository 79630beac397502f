"""What the tracking benchmarks share: choose the passes, run them with a progress line, print and write the rows."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import orjson
import typer
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from service.bench.ablation import choose_variants, overlay
from service.bench.cases import Case, ModelShelf
from service.bench.folder import find_sequences
from service.bench.machine import describe_machine
from service.bench.passes import random_case
from service.bench.plots import require_matplotlib, write_plots
from service.bench.report import case_table, markdown_report, overall_rows, overall_table, write_frames
from service.bench.runner import CaseResult, Entry, Terms, run_case
from service.bench.summary import Row, case_row
from service.cli.model_file import read_model_file
from service.cli.options import choose_joints, parse_size
from service.cli.simulate import pass_seed, random_scenario
from service.sessions.config import effective
from service.workers.tracker import Tracker

_FILE_WIDTH = 200
_MOST_PRINTED = 60  # rows; of more only the totals


@dataclass(frozen=True)
class Selection:
    """Which passes: a folder's sequences, or ``passes`` drawn at random."""

    folder: Path | None
    names: tuple[str, ...]
    meshes_root: Path | None
    passes: int
    seed: int
    meshes: tuple[str, ...]
    joints: str | None
    size: str | None
    frames: int | None
    materials: str | None = None
    untied_deg: float | None = None  # see ``SequenceFolder``

    def __post_init__(self) -> None:
        """Raises ``typer.BadParameter`` where what is of a folder's passes is told of drawn ones."""
        told = {
            "a folder": self.folder,
            "--case": self.names,
            "--meshes": self.meshes_root,
            "--untied": self.untied_deg,
        }
        if self.passes and (of_folders := [name for name, value in told.items() if value not in (None, ())]):
            raise typer.BadParameter(f"{' and '.join(of_folders)} cannot be told with --passes, which are drawn")

    @property
    def title(self) -> str:
        """What is measured, in a line."""
        if self.passes:
            return f"{self.passes} {self.materials or 'painted'} passes drawn at random (seed {self.seed})"
        return f"folder {self._folder.name}"

    @property
    def count(self) -> int:
        """Number of passes."""
        return self.passes or len(find_sequences(self._folder, self.names, self.meshes_root, self.untied_deg))

    def cases(self, shelf: ModelShelf) -> Iterator[Case]:
        """The passes one by one; each is prepared when it is asked for."""
        if not self.passes:
            for sequence in find_sequences(self._folder, self.names, self.meshes_root, self.untied_deg):
                yield sequence.case(shelf)
            return
        files = [read_model_file(source) for source in self.meshes or ("demo",)]
        models = [shelf.model(file.name, file.data) for file in files]
        free = [choose_joints(self.joints, tuple(j.name for j in m.articulation.joints)) for m in models]
        for k in range(self.passes):
            which = k % len(models)
            size = None if self.size is None else parse_size(self.size)
            scenario = random_scenario(self.materials, pass_seed(self.seed, k), size, self.frames)
            yield random_case(f"pass_{k:03d}", models[which], scenario, free[which])

    @property
    def _folder(self) -> Path:
        if self.folder is None:
            raise typer.BadParameter("give a folder of sequences, or --passes")
        return self.folder


@dataclass(frozen=True)
class Output:
    """Where the figures go, beside the terminal."""

    title: str
    command: str
    json: Path | None
    report: Path | None


def entries_of(presets: Sequence[str], settings: Sequence[str]) -> list[Entry]:
    """An entry per preset. Raises ``ConfigError`` for a setting that there is not."""
    given = read_settings(settings)
    return [Entry(name, effective(overlay({"filter": {"preset": name}}, given))) for name in presets]


def variant_entries(names: Sequence[str], settings: Sequence[str]) -> list[Entry]:
    """An entry per variant of the default preset. Raises ``VariantError`` for an unknown one."""
    given = read_settings(settings)
    return [
        Entry(v.name, effective(overlay(given, v.sections)), v.twins, v.says, v.priors) for v in choose_variants(names)
    ]


def read_settings(settings: Sequence[str]) -> dict[str, dict[str, Any]]:
    """``filter.particles=200`` and the like -> sections of a session. A value is JSON, or else a word."""
    found: dict[str, dict[str, Any]] = {}
    for setting in settings:
        path, equals, text = setting.partition("=")
        section, dot, name = path.partition(".")
        if not (equals and dot and section and name):
            raise typer.BadParameter(f"{setting!r} is not SECTION.NAME=VALUE")
        try:
            value = orjson.loads(text)
        except orjson.JSONDecodeError:
            value = text
        found.setdefault(section, {})[name] = value
    return found


def run_benchmark(selection: Selection, entries: Sequence[Entry], terms: Terms, output: Output) -> None:
    """Run, print, write. What was measured before an interruption is written too."""
    if output.report is not None:
        require_matplotlib()
    results: list[CaseResult] = []
    tracker = Tracker()
    try:
        with bench_progress() as progress:
            task = progress.add_task("", total=selection.count)
            for case in selection.cases(ModelShelf(tracker)):
                hear = partial(_tell, progress, task, case.name)
                results += run_case(tracker, case, entries, terms, hear)
                progress.update(task, advance=1)
    finally:
        tracker.close()
        rows = [case_row(result) for result in results]
        if rows:
            total = overall_rows(rows, {entry.name: entry.says for entry in entries})
            _print(rows, total)
            _write(selection, results, rows, total, output)


def _write(
    selection: Selection, results: Sequence[CaseResult], rows: Sequence[Row], total: Sequence[Row], output: Output
) -> None:
    machine = {**describe_machine(), "scorer": results[0].scorer}
    document: Mapping[str, Any] = {"machine": machine, "rows": rows, "overall": total}
    data = orjson.dumps(document, option=orjson.OPT_INDENT_2)
    if output.json is not None:
        output.json.write_bytes(data)
    if output.report is not None:
        output.report.mkdir(parents=True, exist_ok=True)
        (output.report / "rows.json").write_bytes(data)
        write_frames(results, output.report / "frames.csv")
        plots = write_plots(results, rows, output.report)
        page = markdown_report(f"{output.title}: {selection.title}", output.command, machine, rows, total, plots)
        (output.report / "report.md").write_text(page)


def _print(rows: Sequence[Row], total: Sequence[Row]) -> None:
    console = Console()
    if not console.is_terminal:  # a file has no width: columns are not cut short
        console = Console(width=_FILE_WIDTH)
    if len(rows) <= _MOST_PRINTED:
        console.print(case_table(rows))
    console.print(overall_table(total))


def bench_progress() -> Progress:
    """A line on standard error."""
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    return Progress(*columns, console=Console(stderr=True))


def _tell(progress: Progress, task: Any, name: str, frames: int) -> None:
    progress.update(task, description=f"{name}: frame {frames}")

"""``skypose bench``: how good, how sure and how fast, on passes with known truth."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Literal

import typer

from service.cli.bench_engines import engines
from service.cli.bench_light import light
from service.cli.bench_likelihood import likelihood
from service.cli.bench_load import load
from service.cli.bench_misfits import misfits
from service.cli.bench_motion import motion
from service.cli.bench_real import real
from service.cli.bench_scorers import scorers
from service.cli.bench_sky import sky
from service.cli.bench_start import start
from service.cli.bench_step import step

bench = typer.Typer(name="bench", no_args_is_help=True, help="Benchmarks: accuracy, calibration, time, load.")

Folder = Annotated[Path | None, typer.Argument(help="Folder of sequences (case.json in each), or one sequence.")]
Names = Annotated[list[str] | None, typer.Option("--case", help="Only this sequence; may be repeated.")]
Limit = Annotated[int | None, typer.Option(min=1, help="Only so many frames of each pass.")]
Json = Annotated[Path | None, typer.Option("--json", help="Write the rows as JSON.")]
Report = Annotated[Path | None, typer.Option(help="Folder for report.md: tables and plots.")]
Passes = Annotated[int, typer.Option(min=0, help="Instead of a folder: so many simulated passes drawn at random.")]
Seed = Annotated[int, typer.Option(min=0, help="Of the simulated passes, as in 'skypose simulate --random'.")]
Meshes = Annotated[list[str] | None, typer.Option("--mesh", help="Mesh file of simulated passes; may be repeated.")]
Joints = Annotated[str | None, typer.Option(help="Joints of simulated passes: all, none, or A,B.")]
Size = Annotated[str | None, typer.Option(help="Of simulated images; else 256x256, mixed 192x192.")]
Frames = Annotated[int | None, typer.Option(min=1, help="Of each simulated pass; else 40, mixed 14.")]
Materials = Annotated[str | None, typer.Option(help="Of simulated passes: painted, or mixed as real ones are.")]
Root = Annotated[Path | None, typer.Option("--meshes", help="Where the sequences' meshes lie, if not beside them.")]
Settled = Annotated[int, typer.Option("--from", min=0, help="Visible frames that count for acquisition only.")]
Alteration = Literal[
    "jpeg", "video", "denoised", "sharpened", "black", "full", "gamma", "gain", "steps", "bars", "stabilised", "clock"
]
Set = Annotated[list[str] | None, typer.Option("--set", help="SECTION.NAME=VALUE for all sessions; may be repeated.")]

bench.command()(scorers)
bench.command()(start)
bench.command()(sky)
bench.command()(step)
bench.command()(light)
bench.command()(likelihood)
bench.command()(misfits)
bench.command()(motion)
bench.command()(real)
bench.command()(load)
bench.command()(engines)


@bench.command()
def track(
    folder: Folder = None,
    preset: Annotated[list[str] | None, typer.Option(help="balanced, paper; may be repeated. Default: both.")] = None,
    case: Names = None,
    limit: Limit = None,
    json: Json = None,
    report: Report = None,
    passes: Passes = 0,
    seed: Seed = 0,
    mesh: Meshes = None,
    joints: Joints = None,
    size: Size = None,
    frames: Frames = None,
    materials: Materials = None,
    meshes: Root = None,
    settings: Set = None,
    settled: Settled = 10,
    nosun: Annotated[bool, typer.Option("--nosun", help="Do not tell the sessions where the Sun stands.")] = False,
    sun_off: Annotated[float, typer.Option(help="Tell them wrongly, by so many degrees.")] = 0.0,
    known_range: Annotated[bool, typer.Option("--range", help="Tell them the scale as a range gives it.")] = False,
    stretch: Annotated[float | None, typer.Option(help="Frames whose counts are the light to this power.")] = None,
    own_sky: Annotated[
        bool, typer.Option("--own-sky", help="Give no empty frames: the sky is the frames' own.")
    ] = False,
    exact_mesh: Annotated[
        bool, typer.Option("--exact-mesh", help="Do not tell them how far a mesh is off its body.")
    ] = False,
    canvas: Annotated[
        int | None, typer.Option(min=64, max=8192, help="Frames in the midst of so many px of their sky, a side.")
    ] = None,
    cut: Annotated[
        float | None, typer.Option(min=0, max=0.5, help="Frames that end above such a share of the body.")
    ] = None,
    guided: Annotated[int | None, typer.Option(min=1, help="Frames moved by up to so many px, as by hand.")] = None,
    early: Annotated[int | None, typer.Option(min=1, help="Frames of empty sky ahead of each pass.")] = None,
    every: Annotated[int | None, typer.Option(min=1, help="Only one frame in so many, as a slow camera.")] = None,
    untied: Annotated[
        float | None, typer.Option(help="All joints move on their own, each known within so many degrees.")
    ] = None,
    altered: Annotated[Alteration | None, typer.Option(help="What a program did to the frames; nobody tells.")] = None,
) -> None:
    """Run presets over passes with known truth."""
    from service.bench.runner import Terms
    from service.bench.told import Told
    from service.cli.bench_run import Output, Selection, entries_of, run_benchmark

    seen = (stretch, not exact_mesh, canvas, cut, guided, early, every, altered)
    told = Told(not nosun, sun_off, known_range, not own_sky, *seen)
    terms = Terms(limit, settled, told)
    with refusals():
        names, bodies = tuple(case or ()), tuple(mesh or ())
        selection = Selection(folder, names, meshes, passes, seed, bodies, joints, size, frames, materials, untied)
        entries = entries_of(preset or ["balanced", "paper"], settings or ())
        run_benchmark(selection, entries, terms, Output("Tracking", command_line(), json, report))


@bench.command()
def ablate(
    folder: Folder = None,
    variant: Annotated[list[str] | None, typer.Option(help="Only this variant; may be repeated.")] = None,
    case: Names = None,
    limit: Limit = None,
    json: Json = None,
    report: Report = None,
    passes: Passes = 0,
    seed: Seed = 0,
    mesh: Meshes = None,
    joints: Joints = None,
    size: Size = None,
    frames: Frames = None,
    materials: Materials = None,
    meshes: Root = None,
    settings: Set = None,
    settled: Settled = 10,
) -> None:
    """The default preset with each of its choices switched off, one at a time."""
    from service.bench.runner import Terms
    from service.cli.bench_run import Output, Selection, run_benchmark, variant_entries

    with refusals():
        names, bodies = tuple(case or ()), tuple(mesh or ())
        selection = Selection(folder, names, meshes, passes, seed, bodies, joints, size, frames, materials)
        entries = variant_entries(variant or (), settings or ())
        title = "Each choice switched off"
        run_benchmark(selection, entries, Terms(limit, settled), Output(title, command_line(), json, report))


@contextmanager
def refusals() -> Iterator[None]:
    """What a user can mend is told in a line, without a traceback."""
    from service.bench.ablation import VariantError
    from service.bench.folder import SequenceError
    from service.bench.plots import PlotsMissingError
    from service.errors import SkyposeError

    try:
        yield
    except (SkyposeError, SequenceError, VariantError, PlotsMissingError) as error:
        typer.secho(str(error), fg="red", err=True)
        raise typer.Exit(1) from error


def command_line() -> str:
    """The command as it was typed, for a report."""
    return " ".join(["skypose", *sys.argv[1:]])

"""``skypose bench motion``: rate, axis and law of simulated passes."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from service.bench.motion_streams import StreamPlan
    from service.bench.told_laws import ToldLaw


def motion(
    passes: Annotated[int, typer.Option(min=1, help="Of each law: constant rate, tumbling.")] = 100,
    frames: Annotated[int, typer.Option(min=3, help="Of each pass.")] = 300,
    span: Annotated[float, typer.Option(min=0.1, help="Of each pass, s.")] = 60.0,
    nutation: Annotated[float, typer.Option(min=0, max=60, help="Least of tumbling bodies, degrees.")] = 0.0,
    slowest: Annotated[float, typer.Option(min=1e-3, help="Rate, °/s.")] = 0.05,
    tracked: Annotated[int, typer.Option(min=0, help="So many passes drawn and tracked, in the place of streams.")] = 0,
    nosun: Annotated[bool, typer.Option("--nosun", help="Tracked passes are not told where the Sun is.")] = False,
    modes: Annotated[int, typer.Option(min=0, help="So many passes in attitude modes, in the place of both.")] = 0,
    joints: Annotated[int, typer.Option(min=0, help="So many tracked with a wing, in the place of all these.")] = 0,
    stations: Annotated[int, typer.Option(min=0, help="So many passes over two telescopes, in their place.")] = 0,
    base: Annotated[float, typer.Option(min=0, help="Between the two, km; the object is 700 km away.")] = 300.0,
    seed: Annotated[int, typer.Option(min=0, help="Of the passes.")] = 0,
    json: Annotated[Path | None, typer.Option("--json", help="Write the rows as JSON.")] = None,
) -> None:
    """How a body turned, from streams of what frames say (docs/motion.md): errors, and whether spreads hold."""
    from service.bench.machine import describe_machine
    from service.bench.motion_bench import MotionRow, motion_document, motion_table, run_streams
    from service.bench.motion_streams import StreamPlan
    from service.cli.bench_output import publish

    if modes:
        _modes(modes, frames, seed, json)
        return
    if joints:
        _joints(StreamPlan(frames, span, (slowest, max(10.0, slowest))), joints, seed, json)
        return
    if stations:
        _stations(StreamPlan(frames, span, (slowest, max(10.0, slowest))), stations, base, seed, json)
        return

    def tell(row: MotionRow) -> None:
        typer.echo(f"{row.law} {row.rate_deg_s:.3f} °/s: {row.vector_error_deg_s:.4f} °/s off", err=True)

    plan = StreamPlan(frames, span, (slowest, max(10.0, slowest)), least_nutation_deg=nutation)
    if tracked:
        from service.bench.tracked_motion import run_tracked

        rows = run_tracked(plan, tracked, seed, tell, sun=not nosun)
    else:
        rows = run_streams(plan, passes, seed, tell)
    document = motion_document(dict(describe_machine()), rows)
    publish(document, (motion_table(document),), None, json, None)


def _stations(plan: StreamPlan, passes: int, base: float, seed: int, json: Path | None) -> None:
    from service.bench.machine import describe_machine
    from service.bench.station_streams import StationRow, run_stations, station_document, station_table
    from service.cli.bench_output import publish

    def tell(row: StationRow) -> None:
        told = ", ".join(f"{name} {row.error_deg[name]:.2f}°" for name in row.error_deg)
        typer.echo(f"{row.rate_deg_s:.3f} °/s: {told}", err=True)

    document = station_document(dict(describe_machine()), run_stations(plan, passes, base, seed, tell))
    publish(document, (station_table(document),), None, json, None)


def _modes(passes: int, frames: int, seed: int, json: Path | None) -> None:
    from service.bench.machine import describe_machine
    from service.bench.mode_streams import mode_document, run_modes
    from service.bench.told_laws import told_tables
    from service.cli.bench_output import publish

    document = mode_document(describe_machine(), run_modes(passes, frames, seed, _tell))
    publish(document, told_tables("attitude modes", document), None, json, None)


def _joints(plan: StreamPlan, passes: int, seed: int, json: Path | None) -> None:
    from service.bench.machine import describe_machine
    from service.bench.told_laws import told_tables
    from service.bench.tracked_joints import joint_document, run_joints
    from service.cli.bench_output import publish

    document = joint_document(describe_machine(), run_joints(plan, passes, seed, _tell))
    publish(document, told_tables("the joints of passes", document), None, json, None)


def _tell(row: ToldLaw) -> None:
    typer.echo(f"{row.truth}: {row.told} {row.probability:.3f}", err=True)

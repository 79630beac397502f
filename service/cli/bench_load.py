"""``skypose bench load``: how many sessions a service carries, and what a frame costs it."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from service.bench.load.cost import Counters, Meter
    from service.bench.load.plan import LoadPlan, LoadRow
    from service.bench.load.scene import Scene

_HOST = "127.0.0.1"


def load(
    url: Annotated[str | None, typer.Option(help="A running service; without it one is started here.")] = None,
    key: Annotated[str | None, typer.Option(envvar="SKYPOSE_API_KEY", help="API key, where the service asks.")] = None,
    workers: Annotated[
        list[int] | None,
        typer.Option(min=0, help="Of the service started here, 0: as many as it needs; may be repeated. Default: 0."),
    ] = None,
    particles: Annotated[list[int] | None, typer.Option(min=1, max=10_000_000, help="May be repeated.")] = None,
    rate: Annotated[
        list[float] | None, typer.Option(min=0.01, help="Frames per second of each session; may be repeated.")
    ] = None,
    bound_ms: Annotated[float, typer.Option(min=1, help="The 99th percentile must stay below it.")] = 500.0,
    seconds: Annotated[float, typer.Option(min=0.5, help="Of each measurement.")] = 10.0,
    most_sessions: Annotated[int, typer.Option(min=1, help="No more than so many.")] = 256,
    size: Annotated[str, typer.Option(help="Of the images.")] = "256x256",
    mesh: Annotated[str, typer.Option(help="demo, or a mesh file.")] = "demo",
    json: Annotated[Path | None, typer.Option("--json", help="Write the rows as JSON.")] = None,
    plot: Annotated[Path | None, typer.Option("--plot", help="Write a plot (PNG, SVG or PDF).")] = None,
) -> None:
    """Sessions x frame rate x particles, more and more, until the 99th percentile passes a bound."""
    from functools import partial

    from service.bench.load.plan import LoadPlan
    from service.bench.load.report import capacity_table, cost_table, load_document, load_plot
    from service.bench.machine import describe_machine
    from service.cli.bench_output import publish, told

    with told(plot), load_refusals():
        given = LoadPlan(tuple(particles or (1000,)), tuple(rate or (2.0,)), bound_ms, seconds, most_sessions)
        scene = _scene(mesh, size)
        rows: list[LoadRow] = []
        try:
            if url is not None:
                _remote(url, key, scene, given, rows)
            else:
                _local(workers or [0], scene, given, rows)
        finally:  # an interrupted run tells what it has measured
            if rows:
                tables = capacity_table(given, rows), cost_table(rows)
                document = load_document(describe_machine(), given, rows)
                publish(document, tables, partial(load_plot, rows, bound_ms), json, plot)
    raise typer.Exit(0 if any(row.held for row in rows) else 1)


@contextmanager
def load_refusals() -> Iterator[None]:
    """What a user can mend, in a line."""
    import httpx

    from service.bench.load.plan import LoadError
    from service.cli.demo_service import DemoError

    try:
        yield
    except (LoadError, DemoError, httpx.TransportError) as error:
        typer.secho(str(error) or type(error).__name__, fg="red", err=True)
        raise typer.Exit(1) from error


def _scene(mesh: str, size: str) -> Scene:
    from service.bench.load.scene import simulated_scene
    from service.cli.model_file import read_model_file
    from service.cli.options import parse_size

    model = read_model_file(mesh)
    return simulated_scene(model.name, model.data, model.mesh, model.articulation, parse_size(size))


def _local(workers: Sequence[int], scene: Scene, plan: LoadPlan, rows: list[LoadRow]) -> None:
    """A fresh service for each number of workers; SKYPOSE_... of the environment hold for it."""
    from tempfile import TemporaryDirectory

    from service.bench.load.cost import ServerMeter
    from service.cli.demo_service import ServiceProcess, free_port

    for n in workers:
        with TemporaryDirectory(prefix="skypose-load-") as folder:
            options = ("--workers", str(n))
            with ServiceProcess(_HOST, free_port(_HOST), Path(folder), options) as service:
                meter = ServerMeter(service.pid, _counters(Path(folder) / "data"))
                _measure(service.url, None, scene, plan, rows, meter)


def _counters(data: Path) -> Counters:
    from service.bench.load.cost import PostgresCounters, SqliteCounters
    from service.settings import Settings

    url = Settings().database_url.get_secret_value()
    return PostgresCounters(url) if url else SqliteCounters(data / "skypose.sqlite3")


def _remote(url: str, key: str | None, scene: Scene, plan: LoadPlan, rows: list[LoadRow]) -> None:
    from service.bench.load.cost import ClientMeter

    _measure(url, key, scene, plan, rows, ClientMeter())


def _measure(url: str, key: str | None, scene: Scene, plan: LoadPlan, rows: list[LoadRow], meter: Meter) -> None:
    import asyncio

    from service.bench.load.http_target import HttpTarget
    from service.bench.load.report import row_line
    from service.bench.load.search import Service, measure_service

    def hear(row: LoadRow) -> None:
        rows.append(row)
        typer.echo(row_line(row), err=True)

    async def run() -> None:
        async with HttpTarget(url, key, scene) as target:
            settings = (await target.system())["settings"]
            service = Service(target, meter, settings.get("engine", "process"), settings.get("workers", 0))
            try:
                await measure_service(service, plan, hear)
            finally:
                await target.end()

    asyncio.run(run())

"""``skypose demo``: the service, the bundled satellite, and a pass of it, in one go."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from rich.console import Console

    from service.cli.demo_pass import DemoPass, FrameResult, Verdict
    from service.cli.model_file import ModelFile
    from service.simulate.sequence import SimulatedPass

_HOST = "127.0.0.1"


def demo(
    once: Annotated[bool, typer.Option("--once", help="Stop after the pass; fails if the track was lost.")] = False,
    port: Annotated[int, typer.Option(min=1, max=65535, help="Port of the service.")] = 8000,
    out: Annotated[Path, typer.Option(help="Folder for the contact sheet, log and data.")] = Path("out/demo"),
    frames: Annotated[int | None, typer.Option(min=1, help="Frames of the pass.")] = None,
    seed: Annotated[int, typer.Option(min=0, help="Another seed is another pass.")] = 0,
) -> None:
    """Track a simulated pass of the bundled satellite over REST and compare each pose with the truth."""
    import shutil
    import signal

    from rich.console import Console

    from service.cli.demo_pass import DemoPass
    from service.cli.demo_service import DemoError, ServiceProcess

    signal.signal(signal.SIGTERM, signal.default_int_handler)  # ended either way, it takes the service along
    console = Console()
    shutil.rmtree(out / "data", ignore_errors=True)  # the previous demo's sessions
    out.mkdir(parents=True, exist_ok=True)
    try:
        with ServiceProcess(_HOST, port, out) as service:
            console.print(f"service ready at {service.url}, live view {service.url}/")
            client = DemoPass(service.url, *_make_pass(frames, seed))
            try:
                verdict = _run(client, console, out / "contact_sheet.png")
            finally:
                client.close()
            if not once:
                console.print(f"live view: {service.url}/   (Ctrl-C ends)")
                service.wait()
    except DemoError as error:
        console.print(f"[red]{error}[/red]")
        raise typer.Exit(2) from error
    except KeyboardInterrupt:
        raise typer.Exit(0) from None
    raise typer.Exit(0 if verdict.held else 1)


def _make_pass(frames: int | None, seed: int) -> tuple[ModelFile, SimulatedPass]:
    from dataclasses import replace

    from service.cli.model_file import read_model_file
    from service.simulate.scenario import PRESETS
    from service.simulate.sequence import SimulatedPass

    model = read_model_file("demo")
    scenario = replace(PRESETS["demo"](), seed=seed)
    if frames is not None:
        scenario = replace(scenario, motion=replace(scenario.motion, frames=frames))
    return model, SimulatedPass(model.mesh, model.articulation, scenario)


def _run(client: DemoPass, console: Console, sheet: Path) -> Verdict:
    from service.cli.demo_pass import judge

    client.open()
    console.print(_HEADER, soft_wrap=True, highlight=False)
    results = []
    for result in client.track():
        results.append(result)
        console.print(_line(result), soft_wrap=True, highlight=False)
    client.write_sheet(results, sheet)
    verdict = judge(results)
    console.print(
        f"{'track held' if verdict.held else 'TRACK LOST'}: {100 * verdict.within_share:.0f} % of the settled frames "
        f"within 5 deg, median error {verdict.median_error_deg:.2f} deg, median IoU {verdict.median_iou:.3f}",
        soft_wrap=True,
    )
    console.print(f"contact sheet: {sheet}")
    return verdict


_HEADER = "frame  status      yaw    pitch     roll | error: deg     px  scale %  wing deg    IoU |    ms"


def _line(result: FrameResult) -> str:
    best, errors = result.answer["best"], result.errors
    angles = f"{best['yaw_deg']:8.1f} {best['pitch_deg']:8.1f} {best['roll_deg']:8.1f}"
    figures = f"{errors.orientation_deg:10.2f} {errors.position_px:6.2f} {errors.scale_percent:8.2f}"
    ms = result.answer["timing_ms"]["total"]
    return (
        f"{result.index + 1:5d}  {result.answer['status']:<9s}{angles} | {figures} {errors.joint:9.2f} "
        f"{errors.iou:6.3f} | {ms:5.0f}"
    )

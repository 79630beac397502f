"""``skypose simulate``: a pass with known truth, as a folder."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

if TYPE_CHECKING:
    from service.cli.model_file import ModelFile
    from service.simulate.materials import Materials
    from service.simulate.overflight import Overflight
    from service.simulate.scenario import Scenario

_SEED_STRIDE = 7919  # passes of neighbouring seeds do not overlap until there are so many


def simulate(
    out: Annotated[Path, typer.Option(help="Folder to write.")],
    mesh: Annotated[list[str] | None, typer.Option(help="Mesh file, or 'demo'. --random takes several.")] = None,
    preset: Annotated[str, typer.Option(help="night, day, seeing, phase90, panel, small, outage or demo.")] = "demo",
    frames: Annotated[int | None, typer.Option(min=1, max=100_000, help="Number of frames.")] = None,
    size: Annotated[str | None, typer.Option(help="Width x height in pixels, such as 320x240.")] = None,
    seed: Annotated[int, typer.Option(min=0, help="Same seed, same images.")] = 0,
    joints: Annotated[str | None, typer.Option(help="Joints that move: all, none, or A,B.")] = None,
    random: Annotated[int, typer.Option(min=0, help="So many passes drawn at random, each in a folder.")] = 0,
    materials: Annotated[str | None, typer.Option(help="painted, or mixed: a body made as real ones are.")] = None,
    site: Annotated[
        list[str] | None,
        typer.Option(help="LAT,LON,HEIGHT: a real pass over it (degrees, metres); several: one object from each."),
    ] = None,
    tle: Annotated[Path | None, typer.Option(help="File with the elements of the satellite of that pass.")] = None,
    time: Annotated[str | None, typer.Option(help="When it begins: ISO 8601, UTC unless it says otherwise.")] = None,
    up_angle: Annotated[float, typer.Option(help="From celestial north to the image's up, degrees.")] = 0.0,
    ground: Annotated[
        float, typer.Option(min=0, max=10, help="Brightest of a ground behind the body, in white facets in the Sun.")
    ] = 0.0,
    path_traced: Annotated[bool, typer.Option("--path-traced", help="Light by Mitsuba, a path tracer.")] = False,
    mesh_error: Annotated[
        float, typer.Option(min=0, max=0.5, help="How far the body is from the mesh: of its pieces' sizes.")
    ] = 0.0,
    as_json: Annotated[bool, typer.Option("--json", help="Print a line of JSON about each pass.")] = False,
) -> None:
    """Make a simulated pass: background and frames as PNG, truth.csv, case.json and the mesh."""
    from service.cli.model_file import read_model_file
    from service.cli.options import parse_size
    from service.cli.overflight import read_overflights
    from service.simulate.scenario import PRESETS

    overs = read_overflights(site or (), tle, time, up_angle)
    models = [read_model_file(name) for name in mesh or ["demo"]]

    def asked(scenario: Scenario) -> Scenario:
        return replace(before_ground(scenario, ground), path_traced=path_traced, mesh_error=mesh_error)

    wanted = None if size is None else parse_size(size)
    if random:
        for k in range(random):
            scenario = asked(random_scenario(materials, pass_seed(seed, k), wanted, frames))
            _write_all(models[k % len(models)], scenario, overs, out / f"pass_{k:03d}", joints, as_json)
        return
    if preset not in PRESETS:
        raise typer.BadParameter(f"{preset!r} is none of {', '.join(PRESETS)}", param_hint="--preset")
    if len(models) != 1:
        raise typer.BadParameter("several meshes need --random", param_hint="--mesh")
    scenario = replace(PRESETS[preset](), seed=seed, materials=known_materials(materials))
    scenario = asked(replace(scenario, size=wanted or scenario.size))
    if frames is not None:
        scenario = replace(scenario, motion=replace(scenario.motion, frames=frames))
    _write_all(models[0], scenario, overs, out, joints, as_json)


def random_scenario(materials: str | None, seed: int, size: tuple[int, int] | None, frames: int | None) -> Scenario:
    """A pass drawn at random; what it is made of decides what it is drawn from, and the usual size and length."""
    from service.simulate.mixed_passes import randomised_mixed
    from service.simulate.scenario import randomised

    draw = {"painted": randomised, "mixed": randomised_mixed}[known_materials(materials)]
    given: dict[str, Any] = {"size": size, "frames": frames}
    return draw(seed, **{name: value for name, value in given.items() if value is not None})


def before_ground(scenario: Scenario, brightest: float) -> Scenario:
    """The pass as a camera above the body sees it: a ground that drifts, no frame without the body."""
    if not brightest:
        return scenario
    return replace(scenario, background_frames=0, camera=replace(scenario.camera, ground=brightest))


def known_materials(name: str | None) -> Materials:
    """``painted`` where nothing is said. Raises ``typer.BadParameter`` for what there is not."""
    from service.simulate.materials import SURFACES

    for known in SURFACES:
        if known == (name or "painted"):
            return known
    raise typer.BadParameter(f"{name!r} is none of {', '.join(SURFACES)}", param_hint="--materials")


def pass_seed(seed: int, number: int) -> int:
    """Seed of pass ``number`` of a series of random passes."""
    return seed * _SEED_STRIDE + number


def _write_all(
    model: ModelFile,
    scenario: Scenario,
    overflights: Sequence[Overflight],
    folder: Path,
    joints: str | None,
    as_json: bool,
) -> None:
    """The pass, or what each of several sites sees of it."""
    if not overflights:
        _write(model, scenario, folder, joints, as_json)
    for number, over in enumerate(overflights):
        own = folder if len(overflights) == 1 else folder / f"site_{number}"
        _write(model, replace(scenario, overflight=over, telescope=number), own, joints, as_json)


def _write(model: ModelFile, scenario: Scenario, folder: Path, joints: str | None, as_json: bool) -> None:
    import orjson
    from rich.console import Console
    from rich.progress import Progress

    from service.cli.options import choose_joints
    from service.errors import ConfigError, InputError
    from service.simulate.folder import describe, write_sequence
    from service.simulate.overflight import OverflightError
    from service.simulate.path_tracing import PathTracingMissingError
    from service.simulate.sequence import SimulatedPass

    if scenario.motion.joints is None:
        moving = choose_joints(joints, tuple(joint.name for joint in model.articulation.joints))
        scenario = replace(scenario, motion=replace(scenario.motion, joints=moving))
    try:
        simulated = SimulatedPass(model.mesh, model.articulation, scenario)
    except (OverflightError, PathTracingMissingError, InputError, ConfigError) as error:
        raise typer.BadParameter(str(error)) from error
    with Progress(console=Console(stderr=True)) as progress:
        task = progress.add_task(str(folder), total=None)
        write_sequence(
            simulated,
            folder,
            model.name,
            model.data,
            lambda done, total: progress.update(task, completed=done, total=total),
        )
    if as_json:
        typer.echo(orjson.dumps({"out": str(folder), **describe(simulated, folder.name, model.name)}))

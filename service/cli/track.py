"""``skypose track``, also called ``run``: from a folder of frames or a video to files of answers, without a service."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

if TYPE_CHECKING:
    from service.cli.offline import OfflinePass


def track(
    mesh: Annotated[str, typer.Option(help="Mesh file (GLB, OBJ, STL, PLY, URDF), or 'demo'.")],
    frames: Annotated[
        Path, typer.Option(help="Folder of images, in the order of their names, a file of several, or a video.")
    ],
    out: Annotated[Path, typer.Option(help="Folder for what is written.")],
    background: Annotated[
        Path | None, typer.Option(help="Folder of images of empty sky, or a file. Default: learned from the frames.")
    ] = None,
    box: Annotated[str | None, typer.Option(help="x,y,w,h: object in frame 1; background is outside.")] = None,
    border: Annotated[float | None, typer.Option(min=1, help="Background is this margin of frame 1, px.")] = None,
    joints: Annotated[str | None, typer.Option(help="Joint definitions: JSON array, or a JSON file.")] = None,
    free: Annotated[str | None, typer.Option(help="Joints to estimate: all, none, or A,B.")] = None,
    preset: Annotated[str | None, typer.Option(help="balanced or paper.")] = None,
    particles: Annotated[int | None, typer.Option(min=1, help="Number of particles.")] = None,
    seed: Annotated[int | None, typer.Option(min=0, help="Same seed, same estimates.")] = None,
    interval: Annotated[float | None, typer.Option(min=1e-6, help="Seconds between frames.")] = None,
    start: Annotated[str | None, typer.Option(help="Time of frame 1, ISO 8601, where the files do not tell.")] = None,
    site: Annotated[str | None, typer.Option(help="LAT,LON,HEIGHT of the telescope: degrees, metres.")] = None,
    tle: Annotated[Path | None, typer.Option(help="File with the object's elements (TLE or OMM).")] = None,
    pixel_scale: Annotated[float | None, typer.Option(help="Arcseconds of a pixel.")] = None,
    up_angle: Annotated[float | None, typer.Option(help="From celestial north to the image's up, degrees.")] = None,
    unit: Annotated[float | None, typer.Option(help="Metres of a unit of the mesh.")] = None,
    config: Annotated[Path | None, typer.Option(help="Further configuration: JSON file of its sections.")] = None,
    smoothed: Annotated[
        bool, typer.Option("--smoothed", help="CSV and AEM with all frames taken into account.")
    ] = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print how it went as JSON.")] = False,
) -> None:
    """Track an object through images: writes estimates.csv, estimates.jsonl, contact_sheet.png and attitude.aem.

    attitude.aem is written where the pointing is known: out of FITS headers, with --up-angle if they do not tell it.
    """
    from service.cli.images import open_images
    from service.cli.ingest_session import SessionPlan, read_config
    from service.cli.model_file import read_joint_list, read_model_file
    from service.cli.offline import OfflinePass
    from service.cli.options import choose_joints, parse_box
    from service.cli.overflight import parse_time, read_elements
    from service.simulate.satellite import NAME

    if box is not None:
        parse_box(box)  # the session's call takes it as text
    definitions = read_joint_list(joints)
    model = read_model_file(mesh, definitions)
    source = open_images(frames)
    sections = laid_over(
        read_config(config),
        filter={"preset": preset, "particles": particles, "seed": seed},
        motion={"frame_interval_s": interval or source.interval_s},
        camera={"pixel_scale_arcsec": pixel_scale, "up_angle_deg": up_angle, **_place(site)},
        prior={"orbit": None if tle is None else read_elements(tle), "unit_m": unit},
    )
    if free is not None or "joints" not in sections:
        names = tuple(joint.name for joint in model.articulation.joints)
        sections = laid_over(sections, joints={"free": list(choose_joints(free, names))})
    called = Path(model.name).stem
    plan = SessionPlan(None if mesh == NAME else Path(mesh), background, box, border, definitions, sections, called)
    first = None if start is None else parse_time(start)
    run_offline(OfflinePass(model, plan, source, out, first, smoothed), as_json)


def run_offline(offline: OfflinePass, as_json: bool) -> None:
    """Run it in a service of its own, and tell how it went. Exits 1 where that refuses something, and says what."""
    import orjson
    from rich.console import Console

    from service.cli.own_service import own_service
    from service.client import ClientError, RefusedError
    from service.errors import SkyposeError

    console = Console(stderr=True)
    try:
        with own_service() as client:
            summary = offline.run(client, console)
    except (ClientError, SkyposeError) as error:
        console.print(f"[red]{error.detail if isinstance(error, RefusedError) else error}[/red]")
        raise typer.Exit(1) from error
    if as_json:
        typer.echo(orjson.dumps(summary.document()))
    else:
        console.print(summary.line(), soft_wrap=True)


def laid_over(sections: Mapping[str, Any], **given: Mapping[str, Any]) -> dict[str, Any]:
    """Sections of a configuration with what was given on the command line, where it was."""
    merged = dict(sections)
    for name, values in given.items():
        told = {key: value for key, value in values.items() if value is not None}
        if told:
            merged[name] = {**merged.get(name, {}), **told}
    return merged


def _place(site: str | None) -> dict[str, float]:
    from service.cli.overflight import parse_site

    if site is None:
        return {}
    place = parse_site(site)
    named = {"latitude_deg": place.latitude_deg, "longitude_deg": place.longitude_deg, "height_m": place.height_m}
    return {f"site_{name}": value for name, value in named.items()}

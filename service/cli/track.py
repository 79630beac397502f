"""``skypose track``: estimate the pose in a folder of frames or a video, without a service."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer


def track(
    mesh: Annotated[str, typer.Option(help="Mesh file (GLB, OBJ, STL, PLY, URDF), or 'demo'.")],
    frames: Annotated[
        Path, typer.Option(help="Folder of images, in the order of their names, a file of several, or a video.")
    ],
    out: Annotated[Path, typer.Option(help="Folder for estimates and contact sheet.")],
    background: Annotated[
        Path | None, typer.Option(help="Folder of images of empty sky, or a video. Default: learned from the frames.")
    ] = None,
    box: Annotated[str | None, typer.Option(help="x,y,w,h: object in frame 1; background is outside.")] = None,
    border: Annotated[float | None, typer.Option(min=1, help="Background is this margin of frame 1, px.")] = None,
    joints: Annotated[str | None, typer.Option(help="Joint definitions: JSON array, or a JSON file.")] = None,
    free: Annotated[str | None, typer.Option(help="Joints to estimate: all, none, or A,B.")] = None,
    preset: Annotated[str, typer.Option(help="balanced or paper.")] = "balanced",
    particles: Annotated[int | None, typer.Option(min=1, help="Number of particles.")] = None,
    seed: Annotated[int | None, typer.Option(min=0, help="Same seed, same estimates.")] = None,
    interval: Annotated[float | None, typer.Option(min=1e-6, help="Seconds between frames.")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print how it went as JSON.")] = False,
) -> None:
    """Track an object through images: writes estimates.csv, estimates.jsonl and contact_sheet.png."""
    import orjson
    from rich.console import Console

    from service.cli.images import open_images
    from service.cli.model_file import read_joint_list, read_model_file
    from service.cli.offline import OfflinePass, Sky
    from service.cli.options import choose_joints, parse_box
    from service.errors import SkyposeError
    from service.sessions.config import effective

    if (background is not None) + (box is not None) + (border is not None) > 1:
        raise typer.BadParameter("give one of --background, --box, --border")
    definitions = read_joint_list(joints)
    model = read_model_file(mesh, definitions)
    estimated = choose_joints(free, tuple(joint.name for joint in model.articulation.joints))
    filter_options: dict[str, Any] = {"preset": preset}
    filter_options |= {k: v for k, v in (("particles", particles), ("seed", seed)) if v is not None}
    sky = Sky(
        None if background is None else open_images(background),
        None if box is None else parse_box(box),
        border,
    )
    console = Console(stderr=True)
    try:
        config = effective({"filter": filter_options, "joints": {"free": list(estimated)}})
        with OfflinePass(model, definitions, config) as offline:
            summary = offline.run(open_images(frames), sky, out, interval, console)
    except SkyposeError as error:
        console.print(f"[red]{error}[/red]")
        raise typer.Exit(1) from error
    if as_json:
        typer.echo(orjson.dumps(summary.document()))
    else:
        console.print(summary.line())

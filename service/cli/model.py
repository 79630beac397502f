"""``skypose model check``: a mesh as the filter sees it."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

model = typer.Typer(name="model", no_args_is_help=True, help="Spacecraft models.")


@model.command()
def check(
    mesh: Annotated[str, typer.Argument(help="Mesh file (GLB, OBJ, STL, PLY, URDF), or 'demo'.")],
    joints: Annotated[str | None, typer.Option(help="Joint definitions: JSON array, or a JSON file.")] = None,
    unit: Annotated[float | None, typer.Option("--unit-m", min=1e-9, help="Metres in a unit of the model.")] = None,
    out: Annotated[Path | None, typer.Option(help="PNG: six views, surfaces in colours, and lit.")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print it as JSON.")] = False,
) -> None:
    """Say what is in a mesh, and what in it will hurt."""
    import orjson

    from service.cli.model_file import read_joint_list, read_model_file
    from service.cli.model_views import views
    from service.models.check import examine
    from service.models.symmetry import model_symmetries

    read = read_model_file(mesh, read_joint_list(joints))
    found = examine(read.mesh, read.articulation, model_symmetries(read.mesh, read.articulation), unit)
    if out is not None:
        out.write_bytes(views(read.mesh, read.articulation, found.groups))
    told = {
        "name": read.name,
        "faces": read.mesh.n_faces,
        "parts": [part.name for part in read.mesh.parts],
        "joints": [joint.name for joint in read.articulation.joints],
        "size": [round(v, 6) for v in found.size],
        "watertight": read.mesh.watertight,
        "surfaces": [round(v, 4) for v in found.shares],
        "symmetries": list(found.symmetries),
        "findings": list(found.findings),
    }
    if as_json:
        typer.echo(orjson.dumps(told))
        return
    size = " x ".join(f"{v * (unit or 1):.4g}" for v in found.size)
    typer.echo(f"{read.name}: {read.mesh.n_faces} faces, {size} {'m' if unit else 'units'}")
    typer.echo(f"parts: {', '.join(part.name for part in read.mesh.parts)}")
    for joint in read.articulation.joints:
        sign = "°" if joint.kind == "revolute" else " units"
        typer.echo(f"joint {joint.name}: {joint.kind}, {joint.minimum:g} to {joint.maximum:g}{sign}")
    typer.echo(f"surfaces with a brightness of their own: {len(found.shares)}, the largest {max(found.shares):.0%}")
    kinds = [f"{found.symmetries.count(kind)} {kind}" for kind in dict.fromkeys(found.symmetries)]
    typer.echo(f"symmetries of its outline: {', '.join(kinds) or 'none'}")
    for finding in found.findings:
        typer.echo(f"- {finding}")
    if not found.findings:
        typer.echo("nothing in it should hurt")

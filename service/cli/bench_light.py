"""``skypose bench light``: microseconds per sunlit picture with cast shadows, on this machine."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer


class Device(StrEnum):
    """Kinds of OpenCL devices."""

    CPU = "cpu"
    GPU = "gpu"


def light(
    json: Annotated[Path | None, typer.Option("--json", help="Write the rows as JSON.")] = None,
    quick: Annotated[bool, typer.Option("--quick", help="Few poses, few repeats: a look, not a measurement.")] = False,
    mesh: Annotated[
        list[str] | None, typer.Option("--mesh", help="Mesh file, or demo; may be repeated. Default: demo.")
    ] = None,
    side: Annotated[int, typer.Option(min=4, max=1024, help="Of the patch, px.")] = 64,
    supersample: Annotated[int, typer.Option(min=1, max=8, help="Samples along one axis of a pixel.")] = 3,
    shadow: Annotated[int, typer.Option(min=0, max=4096, help="Texels of cast shadows across the body.")] = 256,
    whole: Annotated[bool, typer.Option("--whole", help="All faces of the file, not the mesh for this size.")] = False,
    device: Annotated[Device, typer.Option(help="Kind of OpenCL device.")] = Device.CPU,
    seed: Annotated[int, typer.Option(min=0, help="Of the poses.")] = 0,
) -> None:
    """Time per pose of planes, sums of planes, templates and evidence, and agreement with the twin in NumPy."""
    from dataclasses import replace

    from service.bench.light import LightPlan, bench_light, light_document, light_table
    from service.bench.machine import describe_machine
    from service.cli.bench_output import publish, told
    from service.cli.model_file import read_model_file

    with told(None):
        plan = LightPlan(side=side, supersample=supersample, shadow_px=shadow, seed=seed, coarse=not whole)
        plan = replace(plan, kind=device.value)
        if device is Device.GPU:
            plan = replace(plan, launches=(64, 512, 4096), weighed=(50, 512))
        plan = replace(plan, poses=40, repeats=1, compared=2, launches=(), weighed=()) if quick else plan
        bodies = {Path(name).stem: read_model_file(name).mesh for name in mesh or ["demo"]}
        rows = bench_light(bodies, plan, lambda line: typer.echo(line, err=True))
        publish(light_document(describe_machine(), rows), (light_table(rows),), None, json, None)

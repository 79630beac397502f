"""``skypose bench real``: real camera sequences through the service, and a page of pictures to look at."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def real(
    folder: Annotated[Path, typer.Argument(help="Folder of sequences: sequence.json or case.json in each.")],
    out: Annotated[Path, typer.Option(help="Folder for index.html, pictures and answers.")],
    case: Annotated[list[str] | None, typer.Option("--case", help="Only this sequence; may be repeated.")] = None,
    limit: Annotated[int | None, typer.Option(min=1, help="Only so many frames of each.")] = None,
    border: Annotated[
        float | None, typer.Option(min=1, help="Background is this margin of frame 1, px. Default: the frames' own.")
    ] = None,
    box: Annotated[
        str | None, typer.Option(metavar="X,Y,W,H", help="Background is frame 1 outside of this box, px.")
    ] = None,
    far: Annotated[bool, typer.Option("--far", help="Leave out what is known of a pinhole camera.")] = False,
    json: Annotated[Path | None, typer.Option("--json", help="Write the rows as JSON.")] = None,
    meshes: Annotated[Path | None, typer.Option("--meshes", help="Where meshes lie, if not beside the frames.")] = None,
) -> None:
    """Follow real sequences from nothing but their frames, and draw frame, outline, model's image and residual."""
    from dataclasses import asdict, replace

    import orjson
    from rich.console import Console

    from service.bench.machine import describe_machine
    from service.bench.real import find_real
    from service.cli.bench import refusals
    from service.cli.own_service import own_service
    from service.cli.real_pass import SkyFrom, follow, line_of, page_of

    console, rows, sections = Console(stderr=True), [], []
    with refusals():
        for sequence in find_real(folder, tuple(case or ()), meshes):
            with own_service() as client:
                chosen = replace(sequence, lens=None) if far else sequence
                row, section = follow(client, chosen, out / sequence.name, limit, SkyFrom(box, border), console)
            rows.append(row)
            sections.append(section)
            console.print(line_of(row))
            out.joinpath("index.html").write_text(page_of(sections))
    if json is not None:
        json.write_bytes(orjson.dumps({"machine": describe_machine(), "rows": [asdict(row) for row in rows]}))

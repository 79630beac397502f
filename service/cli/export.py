"""``skypose export``: the attitude history of a session as a file."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from service.cli.remote_options import DEFAULT_URL, Key, Url, connected


def export(
    session: Annotated[str, typer.Argument(help="The session's id.")],
    file_format: Annotated[str, typer.Option("--format", help="aem, acm, apm, stk, czml, csv or npz.")] = "csv",
    out: Annotated[Path | None, typer.Option(help="File to write; without it, standard output.")] = None,
    pose: Annotated[str, typer.Option(help="Which of an estimate's poses: best or mean.")] = "best",
    object_name: Annotated[str | None, typer.Option(help="By default the session's name.")] = None,
    object_id: Annotated[str | None, typer.Option(help="International designator, YYYY-NNNP.")] = None,
    smoothed: Annotated[
        bool | None,
        typer.Option("--smoothed/--filtered", help="With all later frames, or not; by default if the session ended."),
    ] = None,
    model: Annotated[bool, typer.Option("--model", help="With czml: the mesh itself, moved as its joints.")] = False,
    url: Url = DEFAULT_URL,
    key: Key = None,
) -> None:
    """Write a session's attitude history (docs/formats.md)."""
    names = {"object_name": object_name, "object_id": object_id, "model": "true" if model else None}
    options = {name: value for name, value in names.items() if value is not None}
    with connected(url, key) as client:
        body = client.export(session, file_format, smoothed=smoothed, pose=pose, **options)
    if out is None:
        typer.get_binary_stream("stdout").write(body)
    else:
        out.write_bytes(body)

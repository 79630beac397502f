"""``skypose openapi``: the description of the REST interface, without a service."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer


def openapi(
    out: Annotated[Path | None, typer.Option(help="File to write; without it, standard output.")] = None,
) -> None:
    """Write the OpenAPI document. The repository keeps it as docs/openapi.json, and a test compares."""
    text = openapi_text()
    if out is None:
        typer.echo(text, nl=False)
    else:
        out.write_text(text)


def openapi_text() -> str:
    """The document as JSON with sorted keys, so that two versions can be compared line by line."""
    import orjson

    options = orjson.OPT_INDENT_2 | orjson.OPT_SORT_KEYS | orjson.OPT_APPEND_NEWLINE
    return orjson.dumps(openapi_document(), option=options).decode()


def openapi_document() -> dict[str, Any]:
    """What the service answers at ``/openapi.json``."""
    from service.main import create_app
    from service.settings import Settings

    # The document does not depend on settings; nothing is opened before the application starts.
    document: dict[str, Any] = create_app(Settings()).openapi()
    return document

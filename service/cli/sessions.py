"""``skypose sessions``: what a running service tracks, and what of it may go."""

from __future__ import annotations

from datetime import UTC, datetime
from typing import TYPE_CHECKING, Annotated

import typer

from service.cli.remote_options import DEFAULT_URL, Key, Url, connected

if TYPE_CHECKING:
    from service.api.schemas import Session

sessions = typer.Typer(name="sessions", no_args_is_help=True, help="Sessions of a running service.")
Json = Annotated[bool, typer.Option("--json", help="A JSON document a line.")]


@sessions.command("list")
def list_(url: Url = DEFAULT_URL, key: Key = None, as_json: Json = False) -> None:
    """Every session, oldest first: id, frames, status, when it was last used, name."""
    with connected(url, key) as client:
        for one in client.sessions():
            typer.echo(one.model_dump_json() if as_json else _line(one))


@sessions.command()
def prune(
    days: Annotated[float, typer.Option("--older-than", min=0, help="Days without a frame.")],
    name: Annotated[str | None, typer.Option(help="Only those whose name begins so.")] = None,
    yes: Annotated[bool, typer.Option("--yes", help="Delete them; without it they are only listed.")] = False,
    url: Url = DEFAULT_URL,
    key: Key = None,
) -> None:
    """Delete sessions that nobody has used for so long, with their whole history."""
    from service.store.rules import unused

    now = datetime.now(UTC)
    with connected(url, key) as client:
        old = [
            one
            for one in client.sessions()
            if unused(one.updated_at, days, now) and (one.name or "").startswith(name or "")
        ]
        for one in old:
            if yes:
                client.delete_session(one.session_id)
            typer.echo(_line(one))
    frames = sum(one.frames for one in old)
    typer.echo(
        f"{len(old)} sessions, {frames} frames: {'deleted' if yes else 'would go; --yes deletes them'}", err=True
    )


def _line(one: Session) -> str:
    told = f"{one.session_id}  {one.frames:>7} frames  {one.status or '-':<10}  {one.updated_at}  {one.name or ''}"
    return told.rstrip()

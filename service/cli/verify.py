"""``skypose verify``: all of the database looked at, beside a running service or without one."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from sqlalchemy import Engine

FileArgument = Annotated[Path | None, typer.Argument(help="A copy (skypose backup), in the place of what runs.")]
DataOption = Annotated[Path | None, typer.Option("--data", help="Data directory.")]


def verify(file: FileArgument = None, data: DataOption = None) -> None:
    """Check every row of the database: checksums, sequences, what belongs to nothing. Changes nothing.

    A line for each problem, then a count. Exits with 1 where there are problems, 2 where it cannot be looked at.
    """
    from service.errors import SkyposeError
    from service.settings import Settings
    from service.store import sqlite
    from service.store.choice import looking

    try:
        if file is not None and not file.is_file():
            raise typer.BadParameter(f"there is no {file}")
        settings = Settings() if data is None else Settings(data_dir=data)
        problems = verified(looking(settings) if file is None else sqlite.looking(file))
    except SkyposeError as error:
        typer.echo(f"skypose verify: {error.detail}", err=True)
        raise typer.Exit(2) from error
    raise typer.Exit(1 if problems else 0)


def verified(engine: Engine) -> int:
    """Verify a database, print what is found, and return how many problems there are. Raises ``StorageError``."""
    from sqlalchemy.exc import DBAPIError

    from service.errors import StorageError
    from service.store.verify import verify as verify_database

    try:
        with engine.connect() as connection:
            found = verify_database(connection, typer.echo)
    except DBAPIError as error:
        raise StorageError(f"the database cannot be read: {error.orig}") from error
    finally:
        engine.dispose()
    if found.unsealed:
        typer.echo(f"{found.unsealed} rows are of a release before there were checksums")
    counts = (
        ("sessions", found.sessions),
        ("frames", found.frames),
        ("rows", found.rows),
        ("problems", found.problems),
    )
    typer.echo(", ".join(f"{what} {count}" for what, count in counts))
    return found.problems

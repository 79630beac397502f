"""``skypose backup`` and ``skypose restore``: a verified copy of the database, and back."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, NoReturn

import typer

from service.cli.verify import DataOption, verified

POSTGRES = """\
this database is PostgreSQL's, which brings its own tools:
  pg_dump -Fc --file OUT postgresql://...                 a copy, while it is used
  pg_restore --clean --if-exists --dbname postgresql://... OUT   back, with the service stopped
docs/operations.md, Copies of the database; skypose verify checks it afterwards"""


def backup(
    out: Annotated[Path, typer.Argument(help="The file to write; it must not be there.")],
    data: DataOption = None,
) -> None:
    """Copy the database, beside a running service or without one, and verify the copy.

    Exits with 1 where the copy has problems (it is kept, as OUT), 2 where none was made.
    """
    from service.errors import SkyposeError
    from service.store import sqlite
    from service.store.copies import copy

    directory = _data_directory("backup", data)
    if out.exists():
        _refuse("backup", f"{out} is there; give another name")
    try:
        if not (directory / sqlite.FILE).is_file():
            _refuse("backup", f"there is no {directory / sqlite.FILE}")
        problems = copy(directory / sqlite.FILE, out, lambda part: verified(sqlite.looking(part)))
    except SkyposeError as error:
        _refuse("backup", error.detail, error)
    typer.echo(f"{out}: {out.stat().st_size} bytes", err=True)
    raise typer.Exit(1 if problems else 0)


def restore(
    file: Annotated[Path, typer.Argument(help="A copy made by skypose backup.")],
    data: DataOption = None,
) -> None:
    """Put a copy into a data directory that is empty and not in use, once it is verified.

    Exits with 1 where the copy has problems, 2 where it cannot be put there; nothing is changed then.
    """
    from service.errors import SkyposeError
    from service.store import sqlite
    from service.store.copies import into

    directory = _data_directory("restore", data)
    if not file.is_file():
        _refuse("restore", f"there is no {file}")
    try:
        if verified(sqlite.looking(file)):
            raise typer.Exit(1)
        into(directory, file)
    except SkyposeError as error:
        _refuse("restore", error.detail, error)
    typer.echo(f"{directory} is ready: skypose serve --data {directory}", err=True)


def _data_directory(command: str, data: Path | None) -> Path:
    from service.settings import Settings

    settings = Settings() if data is None else Settings(data_dir=data)
    if settings.database_url.get_secret_value():
        _refuse(command, POSTGRES)
    return settings.data_dir


def _refuse(command: str, why: str, error: BaseException | None = None) -> NoReturn:
    typer.echo(f"skypose {command}: {why}", err=True)
    raise typer.Exit(2) from error

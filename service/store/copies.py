"""Copies of an SQLite database, made while it is used, and put back elsewhere."""

from __future__ import annotations

import os
import sqlite3
from collections.abc import Callable
from contextlib import closing
from pathlib import Path
from typing import TypeVar
from urllib.parse import quote

from service.errors import StorageError
from service.store.sqlite import FILE, LOCK, RESERVE, lock

R = TypeVar("R")
_HOLD_NOTHING = {LOCK, RESERVE, "kernels", "lost+found"}
"""What may be in a data directory that a copy is put into: files that hold no data."""


def copy(source: Path, to: Path, check: Callable[[Path], R]) -> R:
    """Copy a database as it is at one moment, its log included, beside a service that writes.

    ``check`` looks at the copy before it has its name, and its answer is returned. Raises ``StorageError``; nothing is
    left then.
    """
    part = to.with_name(f"{to.name}.part")
    part.unlink(missing_ok=True)
    given = f"file:{quote(str(source.absolute()))}?mode=ro"
    try:
        with closing(sqlite3.connect(given, uri=True)) as database, closing(sqlite3.connect(part)) as written:
            database.backup(written)
            written.execute("PRAGMA journal_mode=DELETE")  # one file, without a log beside it
        found = check(part)
        _flush(part)
        part.rename(to)
        _flush(to.parent)
    except (sqlite3.Error, OSError) as error:
        raise StorageError(f"{source} cannot be copied to {to}: {error}") from error
    finally:
        part.unlink(missing_ok=True)
    return found


def into(directory: Path, source: Path) -> None:
    """Make a copy the database of a data directory. Raises ``StorageError`` for one in use or with anything in it."""
    directory.mkdir(parents=True, exist_ok=True)
    held = lock(directory)
    if held is None:
        raise StorageError(f"{directory} is in use by a service")
    with held:
        there = sorted(file.name for file in directory.iterdir() if file.name not in _HOLD_NOTHING)
        if there:
            raise StorageError(f"{directory} is not empty: {', '.join(there[:5])}")
        copy(source, directory / FILE, lambda _: None)


def _flush(path: Path) -> None:
    """Onto the disk: a file's content, a directory's names."""
    opened = os.open(path, os.O_RDONLY)
    try:
        os.fsync(opened)
    finally:
        os.close(opened)

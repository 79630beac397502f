"""The disk under a database file: whether the files are still those that were opened, and room to delete with."""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import structlog

from service.errors import StorageError

log = structlog.get_logger(__name__)
_LEFT_FREE = 1 << 20  # bytes that the reserve leaves to the files which SQLite makes when it opens a database


@dataclass(frozen=True)
class Room:
    """Bytes: of the database, and free on its disk (None: not known here)."""

    used: int
    free: int | None = None


class OpenFiles:
    """Files that are in use. One that was removed or replaced takes all with it that is written to it from then on."""

    def __init__(self, files: Iterable[Path]) -> None:
        self._opened = {file: _identity(file) for file in files}

    def require(self, so_far: str) -> None:
        """Raises ``StorageError`` where one is no longer there; ``so_far`` says what is with the work in hand."""
        for file, opened in self._opened.items():
            if _identity(file) != opened:
                log.error("a file of the database was removed or replaced", file=str(file))
                raise StorageError(f"{file.name} was removed or replaced while it was in use: {so_far}")


def _identity(file: Path) -> tuple[int, int] | None:
    try:
        found = file.stat()
    except FileNotFoundError:
        return None
    return found.st_dev, found.st_ino


class Reserve:
    """A file that keeps disk space, given up when something must be deleted and the disk is full."""

    def __init__(self, file: Path, size: int) -> None:
        self._file = file
        self._size = size

    def fill(self) -> None:
        """Take what is missing, or as much of it as there is. What the disk refuses is logged: it can wait."""
        try:
            held = self._file.stat().st_size if self._file.exists() else 0
            missing = min(self._size - held, free_bytes(self._file.parent) - _LEFT_FREE)
            if missing > 0:
                with self._file.open("ab") as file:
                    os.posix_fallocate(file.fileno(), held, missing)
        except OSError as error:
            log.warning("no disk space kept to delete with", file=str(self._file), error=error.strerror)

    def release(self) -> None:
        """Give it up."""
        self._file.unlink(missing_ok=True)

    def release_if_full(self) -> None:
        """Give it up where there is not even room to open a database."""
        if free_bytes(self._file.parent) < _LEFT_FREE:
            self.release()


def free_bytes(folder: Path) -> int:
    """Free on the disk of a folder, for whom this process runs as."""
    return shutil.disk_usage(folder).free

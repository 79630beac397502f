"""Built kernels, kept from one process to the next: building all takes ten seconds, loading them a tenth of one.

PoCL keeps what it builds in a folder. Here each process has a folder of its own, filled with what earlier ones have
built, so that none is half written by a process that was killed over it: the folder that is kept is only ever replaced
as a whole. No other user can write to it. A process that keeps none still begins with what was installed.
"""

from __future__ import annotations

import contextlib
import fcntl
import os
import shutil
import sys
import tempfile
from pathlib import Path
from typing import IO

INSTALLED = Path(sys.prefix) / "share" / "skypose" / "kernels"
"""Kernels that were built when this program was installed. Another processor or driver builds its own."""
_LOCK = "lock"
_KEPT = "kept"
_OWN = "run-"
_UNDER_WAY = "new-"
_SCRAPS = "tempfile_*"  # PoCL's own, of files that it moves into place


class KernelCache:
    """The kernels under one folder, for the life of a process. Nothing in it is ever needed: all can be built again."""

    def __init__(self, folder: Path, installed: Path | None = None) -> None:
        """``installed``: another such folder, that is only read: what was built when the program was installed."""
        self._folder = folder
        self._sources = [one for one in (installed, folder) if one is not None]
        self._own: Path | None = None
        self._lock: IO[bytes] | None = None

    def open(self) -> None:
        """Take the kernels of earlier processes, before the first look at the devices.

        Does nothing where ``POCL_CACHE_DIR`` is set. Without a folder to write to, every process builds its own.
        """
        if "POCL_CACHE_DIR" in os.environ:
            return
        try:
            self._folder.mkdir(mode=0o700, parents=True, exist_ok=True)
            self._remove_left()
            self._own, self._lock = self._begin()
        except OSError:  # read-only or full
            return
        os.environ["POCL_CACHE_DIR"] = str(self._own)

    def keep(self) -> None:
        """Keep what this process has built, if there is anything new."""
        if self._own is None or _built(self._own) <= _built(self._folder / _KEPT):
            return
        new = None
        try:
            new = Path(tempfile.mkdtemp(prefix=_UNDER_WAY, dir=self._folder))
            _copy(self._own, new / _KEPT)
            with contextlib.suppress(FileNotFoundError):
                (self._folder / _KEPT).rename(new / "before")
            (new / _KEPT).rename(self._folder / _KEPT)
        except OSError:  # full, or another process was first
            pass
        finally:
            if new is not None:
                shutil.rmtree(new, ignore_errors=True)

    def close(self) -> None:
        """Remove this process's folder."""
        if self._own is not None and self._lock is not None:
            shutil.rmtree(self._own, ignore_errors=True)
            self._lock.close()
            self._own = self._lock = None

    def _begin(self) -> tuple[Path, IO[bytes]]:
        """A folder that says by its lock that somebody lives in it, from the moment it has its name."""
        new = Path(tempfile.mkdtemp(prefix=_UNDER_WAY, dir=self._folder))
        lock = (new / _LOCK).open("wb")
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        for source in self._sources:
            take_kept(source, new)
        own = self._folder / new.name.replace(_UNDER_WAY, _OWN)
        new.rename(own)
        return own, lock

    def _remove_left(self) -> None:
        """Folders of processes that were killed."""
        for left in self._folder.glob(f"{_OWN}*"):
            with contextlib.suppress(OSError), (left / _LOCK).open("rb") as lock:
                fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
                shutil.rmtree(left, ignore_errors=True)


def take_kept(source: Path, target: Path) -> None:
    """Copy what is kept under ``source`` into a folder; nothing where there is nothing."""
    with contextlib.suppress(OSError):  # none yet, or replaced at this moment
        _copy(source / _KEPT, target)


def _copy(source: Path, target: Path) -> None:
    shutil.copytree(source, target, dirs_exist_ok=True, ignore=shutil.ignore_patterns(_LOCK, _SCRAPS))


def _built(folder: Path) -> set[str]:
    return {str(path.relative_to(folder)) for path in folder.rglob("*") if path.suffix in (".so", ".bc")}

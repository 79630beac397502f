"""What the store offers, whichever database holds it: transactions run in threads, on plain SQLAlchemy connections.

``sqlite`` is the default: one process, one file. ``postgres`` holds the sessions of several processes.
"""

from __future__ import annotations

import asyncio
from abc import ABC, abstractmethod
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from json import JSONDecodeError
from pathlib import Path
from typing import Concatenate, ParamSpec, TypeVar

import structlog
from sqlalchemy import Connection, Engine, inspect
from sqlalchemy.exc import DBAPIError

from service.errors import DamagedError, StorageError
from service.store.disk import Room
from service.store.signals import Signal

log = structlog.get_logger(__name__)
P = ParamSpec("P")
R = TypeVar("R")

NEWEST_REVISION = "0008"


class Database(ABC):
    """A database that ``open`` brings up to date. Every write is one transaction, every read is on one snapshot."""

    shared = False
    """Whether several processes may serve from it at once."""

    def __init__(self, write_threads: int, read_threads: int) -> None:
        self._write_threads = ThreadPoolExecutor(write_threads, thread_name_prefix="store-write")
        self._read_threads = ThreadPoolExecutor(read_threads, thread_name_prefix="store-read")
        self._writer: Engine | None = None
        self._reader: Engine | None = None
        self._closed = False

    @property
    def writer(self) -> Engine:
        """Engine of the writing threads."""
        assert self._writer is not None, "open() comes first"
        return self._writer

    @property
    def reader(self) -> Engine:
        """Engine of the reading threads."""
        assert self._reader is not None, "open() comes first"
        return self._reader

    async def open(self, *, beside: bool = False) -> None:
        """Connect and bring the schema up to date.

        ``beside``: for a command next to a service that may be running. Raises ``StorageError``.
        """
        await self._run(self._write_threads, lambda: self._open(beside))

    async def write(self, function: Callable[Concatenate[Connection, P], R], *args: P.args, **kwargs: P.kwargs) -> R:
        """Run ``function(connection, ...)`` in a writing thread as one transaction.

        Raises ``StorageError`` where the database refuses: nothing is then stored, or, where the detail says so, it is
        not known whether it is.
        """

        def work(connection: Connection) -> R:
            return function(connection, *args, **kwargs)

        return await self._run(self._write_threads, lambda: self._transaction(work))

    async def free(self, function: Callable[Concatenate[Connection, P], R], *args: P.args, **kwargs: P.kwargs) -> R:
        """As ``write``, for what only deletes: SQLite does it on a full disk too."""

        def work(connection: Connection) -> R:
            return function(connection, *args, **kwargs)

        return await self._run(self._write_threads, lambda: self._freeing(work))

    async def room(self) -> Room:
        """How large the database is, and how much of its disk is free. Raises ``StorageError``."""
        return await self._run(self._write_threads, self._room)

    async def read(self, function: Callable[Concatenate[Connection, P], R], *args: P.args, **kwargs: P.kwargs) -> R:
        """Run ``function(connection, ...)`` in a reading thread, on one snapshot."""

        def work(connection: Connection) -> R:
            return function(connection, *args, **kwargs)

        return await self._run(self._read_threads, lambda: self._snapshot(work))

    def tell(self, signal: Signal) -> None:  # noqa: B027 -- nobody else is there
        """Tell the other processes, where there may be any. From any thread."""

    async def close(self) -> None:
        """Finish what is under way and let go of the database. A second call does nothing."""
        if self._closed:
            return
        self._closed = True
        await asyncio.get_running_loop().run_in_executor(self._write_threads, self._close)
        self._read_threads.shutdown()
        self._write_threads.shutdown()

    async def _run(self, threads: ThreadPoolExecutor, function: Callable[[], R]) -> R:
        try:
            return await asyncio.get_running_loop().run_in_executor(threads, function)
        except DBAPIError as error:
            log.error("database refused", error=str(error.orig))
            raise StorageError(f"the database refused: {error.orig}") from error
        except JSONDecodeError as error:
            raise DamagedError(f"a stored document cannot be read: {error}") from error

    @abstractmethod
    def _open(self, beside: bool) -> None:
        """See ``open``; in a writing thread."""

    @abstractmethod
    def _transaction(self, work: Callable[[Connection], R]) -> R:
        """See ``write``; in a writing thread."""

    def _freeing(self, work: Callable[[Connection], R]) -> R:
        """See ``free``; in a writing thread."""
        return self._transaction(work)

    @abstractmethod
    def _room(self) -> Room:
        """See ``room``; in a writing thread."""

    @abstractmethod
    def _snapshot(self, work: Callable[[Connection], R]) -> R:
        """See ``read``; in a reading thread."""

    def _close(self) -> None:
        for engine in (self._reader, self._writer):
            if engine is not None:
                engine.dispose()
        self._reader = self._writer = None


def migrate(connection: Connection) -> None:
    """Bring the schema up to date; alembic is only loaded where there is something to do.

    Raises ``StorageError`` for a database of a newer release.
    """
    if revision(connection) == NEWEST_REVISION:
        return
    from alembic import command
    from alembic.config import Config
    from alembic.util import CommandError

    config = Config()
    config.set_main_option("script_location", str(Path(__file__).parent / "migrations"))
    config.attributes["connection"] = connection
    try:
        command.upgrade(config, "head")
    except CommandError as error:
        raise StorageError(f"the database is not one that this release can open: {error}") from error


def revision(connection: Connection) -> str | None:
    """Revision of the schema, or None of an empty database."""
    if not inspect(connection).has_table("alembic_version"):
        return None
    found: str | None = connection.exec_driver_sql("SELECT version_num FROM alembic_version").scalar()
    return found

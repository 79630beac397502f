"""SQLite behind threads: one thread writes, a few read, every write is one transaction.

WAL lets readers go on beside the writer; ``synchronous=FULL`` makes a commit survive a power cut.
"""

from __future__ import annotations

import asyncio
import fcntl
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import IO, Any, Concatenate, ParamSpec, TypeVar

import structlog
from sqlalchemy import Connection, Engine, create_engine, event, inspect
from sqlalchemy.exc import DBAPIError

from service.errors import StorageError

log = structlog.get_logger(__name__)
P = ParamSpec("P")
R = TypeVar("R")

NEWEST_REVISION = "0003"
_PRAGMAS = ("journal_mode=WAL", "synchronous=FULL", "foreign_keys=ON", "busy_timeout=10000")


class Database:
    """The database file of a data directory. ``open`` migrates it; one service may hold it at a time."""

    def __init__(self, directory: Path, reader_threads: int) -> None:
        self._directory = directory
        self._write_thread = ThreadPoolExecutor(1, thread_name_prefix="store-write")
        self._read_threads = ThreadPoolExecutor(reader_threads, thread_name_prefix="store-read")
        self._n_readers = reader_threads
        self._writer: Engine | None = None
        self._reader: Engine | None = None
        self._lock: IO[bytes] | None = None
        self._closed = False

    @property
    def writer(self) -> Engine:
        """Engine of the writing thread."""
        assert self._writer is not None, "open() comes first"
        return self._writer

    @property
    def reader(self) -> Engine:
        """Engine of the reading threads."""
        assert self._reader is not None, "open() comes first"
        return self._reader

    async def open(self, *, beside: bool = False) -> None:
        """Lock the directory, open the file, bring its schema up to date.

        ``beside`` a service that holds the lock it opens without, if that service is of this release. Raises
        ``StorageError``.
        """
        await asyncio.get_running_loop().run_in_executor(self._write_thread, self._open, beside)

    async def write(self, function: Callable[Concatenate[Connection, P], R], *args: P.args, **kwargs: P.kwargs) -> R:
        """Run ``function(connection, ...)`` in the writing thread as one transaction.

        Raises ``StorageError`` where the database refuses; nothing of the transaction is then stored.
        """

        def transaction() -> R:
            with self.writer.begin() as connection:
                return function(connection, *args, **kwargs)

        return await self._run(self._write_thread, transaction)

    async def read(self, function: Callable[Concatenate[Connection, P], R], *args: P.args, **kwargs: P.kwargs) -> R:
        """Run ``function(connection, ...)`` in a reading thread, on one snapshot."""

        def snapshot() -> R:
            with self.reader.connect() as connection:
                return function(connection, *args, **kwargs)

        return await self._run(self._read_threads, snapshot)

    async def close(self) -> None:
        """Finish what is under way and let go of the file. A second call does nothing."""
        if self._closed:
            return
        self._closed = True
        await asyncio.get_running_loop().run_in_executor(self._write_thread, self._close)
        self._read_threads.shutdown()
        self._write_thread.shutdown()

    async def _run(self, threads: ThreadPoolExecutor, function: Callable[[], R]) -> R:
        try:
            return await asyncio.get_running_loop().run_in_executor(threads, function)
        except DBAPIError as error:
            log.error("database refused", error=str(error.orig))
            raise StorageError(f"the database refused: {error.orig}") from error

    def _open(self, beside: bool) -> None:
        self._directory.mkdir(parents=True, exist_ok=True)
        in_use = self._take_lock()
        if in_use is not None and not beside:
            raise StorageError(f"{self._directory} is in use by another service") from in_use
        file = self._directory / "skypose.sqlite3"
        self._writer = _engine(file, 1, "BEGIN IMMEDIATE")
        with self._writer.begin() as connection:
            if in_use is None:
                migrate(connection)
            elif _revision(connection) != NEWEST_REVISION:
                raise StorageError(f"{self._directory} is in use by a service of another release")
        self._reader = _engine(file, self._n_readers, "BEGIN")

    def _take_lock(self) -> OSError | None:
        lock = (self._directory / "lock").open("wb")
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            lock.close()
            return error
        self._lock = lock
        return None

    def _close(self) -> None:
        for engine in (self._reader, self._writer):
            if engine is not None:
                engine.dispose()
        self._reader = self._writer = None
        if self._lock is not None:
            self._lock.close()
            self._lock = None


def migrate(connection: Connection) -> None:
    """Bring the schema up to date; alembic is only loaded where there is something to do.

    Raises ``StorageError`` for a database of a newer release.
    """
    if _revision(connection) == NEWEST_REVISION:
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


def _revision(connection: Connection) -> str | None:
    if not inspect(connection).has_table("alembic_version"):
        return None
    revision: str | None = connection.exec_driver_sql("SELECT version_num FROM alembic_version").scalar()
    return revision


def _engine(file: Path, connections: int, begin: str) -> Engine:
    engine = create_engine(
        f"sqlite+pysqlite:///{file}", pool_size=connections, max_overflow=0, pool_reset_on_return="rollback"
    )

    def prepare(connection: Any, _: Any) -> None:
        connection.isolation_level = None  # transactions begin where SQLAlchemy says, as ``begin`` says
        for pragma in _PRAGMAS:
            connection.execute(f"PRAGMA {pragma}")

    event.listen(engine, "connect", prepare)
    event.listen(engine, "begin", lambda connection: connection.exec_driver_sql(begin) and None)
    return engine

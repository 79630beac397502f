"""SQLite behind threads: one thread writes, a few read.

WAL lets readers go on beside the writer; ``synchronous=FULL`` makes a commit survive a power cut.
"""

from __future__ import annotations

import fcntl
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import IO, Any, TypeVar
from urllib.parse import quote

from sqlalchemy import Connection, Engine, create_engine, event

from service.errors import StorageError
from service.store.database import NEWEST_REVISION, Database, migrate, revision

R = TypeVar("R")
FILE = "skypose.sqlite3"
_PRAGMAS = ("journal_mode=WAL", "synchronous=FULL", "foreign_keys=ON", "busy_timeout=10000")


class SqliteDatabase(Database):
    """The database file of a data directory. One service may hold it at a time."""

    def __init__(self, directory: Path, reader_threads: int) -> None:
        super().__init__(1, reader_threads)
        self._directory = directory
        self._n_readers = reader_threads
        self._lock: IO[bytes] | None = None

    def _open(self, beside: bool) -> None:
        """Lock the directory, open the file. ``beside`` a service of this release it opens without the lock."""
        self._directory.mkdir(parents=True, exist_ok=True)
        in_use = self._take_lock()
        if in_use is not None and not beside:
            raise StorageError(f"{self._directory} is in use by another service") from in_use
        file = self._directory / FILE
        self._writer = _engine(file, 1, "BEGIN IMMEDIATE")
        with self._writer.begin() as connection:
            if in_use is None:
                migrate(connection)
            elif revision(connection) != NEWEST_REVISION:
                raise StorageError(f"{self._directory} is in use by a service of another release")
        self._reader = _engine(file, self._n_readers, "BEGIN")

    def _transaction(self, work: Callable[[Connection], R]) -> R:
        with self.writer.begin() as connection:
            return work(connection)

    def _snapshot(self, work: Callable[[Connection], R]) -> R:
        with self.reader.connect() as connection:
            return work(connection)

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
        super()._close()
        if self._lock is not None:
            self._lock.close()
            self._lock = None


def looking(file: Path) -> Engine:
    """An engine that only reads, beside a service or without one: nothing is locked, made or migrated."""
    return _engine(f"file:{quote(str(file.absolute()))}?mode=ro&uri=true", 1, "BEGIN", ("busy_timeout=10000",))


def _engine(file: Path | str, connections: int, begin: str, pragmas: Sequence[str] = _PRAGMAS) -> Engine:
    engine = create_engine(
        f"sqlite+pysqlite:///{file}", pool_size=connections, max_overflow=0, pool_reset_on_return="rollback"
    )

    def prepare(connection: Any, _: Any) -> None:
        connection.isolation_level = None  # transactions begin where SQLAlchemy says, as ``begin`` says
        for pragma in pragmas:
            connection.execute(f"PRAGMA {pragma}")

    event.listen(engine, "connect", prepare)
    event.listen(engine, "begin", lambda connection: connection.exec_driver_sql(begin) and None)
    return engine

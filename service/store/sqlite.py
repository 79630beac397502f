"""SQLite behind threads: one thread writes, a few read.

WAL lets readers go on beside the writer; ``synchronous=FULL`` makes a commit survive a power cut. What is deleted is
not overwritten with zeros where that would cost a write of its own (``secure_delete=FAST``): so a session of any size
is deleted with a small log, on a full disk too.
"""

from __future__ import annotations

import fcntl
import sqlite3
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import IO, Any, TypeVar
from urllib.parse import quote

import structlog
from sqlalchemy import Connection, Engine, create_engine, event
from sqlalchemy.exc import DBAPIError

from service.errors import StorageError
from service.store.database import NEWEST_REVISION, Database, migrate, revision
from service.store.disk import OpenFiles, Reserve, Room, free_bytes

R = TypeVar("R")
log = structlog.get_logger(__name__)
FILE = "skypose.sqlite3"
LOCK, RESERVE = "lock", "reserve"
_BESIDE = ("-wal", "-shm")
_PRAGMAS = ("journal_mode=WAL", "synchronous=FULL", "foreign_keys=ON", "busy_timeout=10000", "secure_delete=FAST")
_DAMAGED = {sqlite3.SQLITE_CORRUPT, sqlite3.SQLITE_NOTADB}
_NO_ROOM = {sqlite3.SQLITE_FULL, sqlite3.SQLITE_IOERR}  # the second: no room for the index of the log


class SqliteDatabase(Database):
    """The database file of a data directory. One service may hold it at a time.

    A file of up to ``check_bytes`` is checked when it is opened; ``reserve_bytes`` of the disk are kept to delete with.
    """

    def __init__(
        self, directory: Path, reader_threads: int, *, check_bytes: int = 1 << 30, reserve_bytes: int = 0
    ) -> None:
        super().__init__(1, reader_threads)
        self._directory = directory
        self._file = directory / FILE
        self._n_readers = reader_threads
        self._check_bytes = check_bytes
        self._reserve = Reserve(directory / RESERVE, reserve_bytes)
        self._lock: IO[bytes] | None = None
        self._opened = OpenFiles(())

    def _open(self, beside: bool) -> None:
        """Lock the directory, open the file. ``beside`` a service of this release it opens without the lock."""
        self._directory.mkdir(parents=True, exist_ok=True)
        self._lock = lock(self._directory)
        if self._lock is None:
            self._open_beside(beside)
        else:
            self._open_own(check=not beside)
        self._reader = _engine(self._file, self._n_readers, "BEGIN")
        self._opened = OpenFiles([self._file, *(Path(f"{self._file}{end}") for end in _BESIDE)])

    def _open_own(self, check: bool) -> None:
        self._reserve.release_if_full()
        size = self._file.stat().st_size if check and self._file.exists() else 0
        self._writer = _engine(self._file, 1, "BEGIN IMMEDIATE")
        try:
            with self._writer.begin() as connection:
                if size:
                    self._require_sound(connection, size)
                migrate(connection)
        except DBAPIError as error:
            if _code(error) in _DAMAGED:
                raise self._damaged(str(error.orig)) from error
            raise
        self._reserve.fill()

    def _open_beside(self, beside: bool) -> None:
        if not beside:
            raise StorageError(f"{self._directory} is in use by another service")
        if not self._file.exists():
            raise StorageError(f"{self._directory} is in use by a service whose database was removed")
        self._writer = _engine(self._file, 1, "BEGIN IMMEDIATE")
        with self._writer.begin() as connection:
            if revision(connection) != NEWEST_REVISION:
                raise StorageError(f"{self._directory} is in use by a service of another release")

    def _require_sound(self, connection: Connection, size: int) -> None:
        if size > self._check_bytes:
            log.info("database not checked: it is large; skypose verify does", bytes=size)
            return
        found = connection.exec_driver_sql("PRAGMA quick_check(1)").scalar()
        if found != "ok":
            raise self._damaged(str(found))

    def _damaged(self, found: str) -> StorageError:
        return StorageError(f"{self._file} is damaged ({found}): docs/operations.md, The database is damaged")

    def _transaction(self, work: Callable[[Connection], R]) -> R:
        with self.writer.begin() as connection:
            result = work(connection)
            self._opened.require("nothing of this is stored")
        self._opened.require("what is stored now is lost with it")
        return result

    def _freeing(self, work: Callable[[Connection], R]) -> R:
        try:
            return self._transaction(work)
        except DBAPIError as error:
            if _code(error) not in _NO_ROOM:
                raise
            log.warning("the disk is full: the reserve is given up to delete", error=str(error.orig))
        self._reserve.release()
        try:
            return self._transaction(work)
        finally:
            self._reserve.fill()

    def _snapshot(self, work: Callable[[Connection], R]) -> R:
        with self.reader.connect() as connection:
            result = work(connection)
        self._opened.require("what is read from it is no longer what is stored")
        return result

    def _room(self) -> Room:
        if self._lock is not None:
            self._reserve.fill()
        try:
            files = (self._file, *(Path(f"{self._file}{end}") for end in _BESIDE))
            return Room(sum(file.stat().st_size for file in files if file.exists()), free_bytes(self._directory))
        except OSError as error:
            raise StorageError(f"the data directory cannot be looked at: {error.strerror}") from error

    def _close(self) -> None:
        super()._close()
        if self._lock is not None:
            self._lock.close()
            self._lock = None


def _code(error: DBAPIError) -> int:
    """SQLite's primary result code."""
    return getattr(error.orig, "sqlite_errorcode", 0) & 0xFF


def lock(directory: Path) -> IO[bytes] | None:
    """The lock of a data directory, to be closed; None where a service has it."""
    file = (directory / LOCK).open("wb")
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        file.close()
        return None
    return file


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

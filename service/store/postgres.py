"""PostgreSQL behind threads: the store of several processes at once.

Transactions run at READ COMMITTED. What is a session's own is written under its row's lock; what counts or shares rows
of several (quotas, blobs) first calls ``alone``, and is then the only such transaction, as every one is in SQLite.
"""

from __future__ import annotations

import random
import threading
import time
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, TypeVar

import structlog
from sqlalchemy import Connection, Engine, create_engine, make_url, text
from sqlalchemy.exc import ArgumentError, DataError, DBAPIError, OperationalError

from service.errors import ConfigError, InputError, StorageError
from service.store.database import Database, migrate
from service.store.disk import Room
from service.store.listener import Listener
from service.store.signals import SENDER, Heard, Signal
from service.store.teller import Teller

if TYPE_CHECKING:
    import psycopg

R = TypeVar("R")
log = structlog.get_logger(__name__)
DRIVER = "postgresql+psycopg"
_MIGRATING = 0x534B_5901
_FIRST_PAUSE_S, _LONGEST_PAUSE_S = 0.02, 0.5
# Rolled back by the server, and worth another try: serialization failure, deadlock, lock not to be had.
_ROLLED_BACK = {"40001", "40P01", "55P03"}
# The connection went: ended by an operator, crash of another backend, starting up, idle in a transaction for too long.
_LOST = {"57P01", "57P02", "57P03", "25P03", "53300"}


class PostgresDatabase(Database):
    """A PostgreSQL database, connected to directly: not through a pooler that shares connections per transaction.

    ``wait_s`` bounds how long a call waits for a server that is not there, or for a lock. ``idle_s``: a transaction
    whose process does not go on for so long (stopped, swapped out) is ended by the server, and its locks with it.
    """

    shared = True

    def __init__(
        self, url: str, *, sender: str, connections: int, reader_threads: int, wait_s: float, idle_s: float
    ) -> None:
        super().__init__(connections, reader_threads)
        self._sender = sender
        self._url = _checked(url)
        self._sizes = connections, reader_threads
        self._wait_s = wait_s
        self._idle_s = idle_s
        self._ending = threading.Event()
        self._listener: Listener | None = None
        self._teller: Teller | None = None

    def listen(self, heard: Heard, resumed: Callable[[], None]) -> None:
        """Hear the signals of other processes and tell them from now on, in threads of their own.

        ``resumed`` is called whenever listening begins (again): signals may have been missed until then.
        """
        self._listener = Listener(self._connect_aside, self._sender, heard, resumed)
        self._listener.start()
        self._teller = Teller(self._connect_aside, self._sender)
        self._teller.start()

    def tell(self, signal: Signal) -> None:
        """Tell the other processes soon, where this one listens to them."""
        if self._teller is not None:
            self._teller.tell(signal)

    def _open(self, beside: bool) -> None:
        writers, readers = self._sizes
        self._writer = self._engine(writers)
        self._transaction(_migrate)
        self._reader = self._engine(readers).execution_options(
            isolation_level="REPEATABLE READ", postgresql_readonly=True
        )

    def _transaction(self, work: Callable[[Connection], R]) -> R:
        """Tried again while it is known that nothing was stored; a lost COMMIT is an error that says so."""
        pauses = _Pauses(self._wait_s, self._ending)
        while True:
            committing = False
            try:
                with self.writer.connect() as connection:
                    transaction = connection.begin()
                    result = work(connection)
                    committing = True
                    transaction.commit()
                    return result
            except DataError as error:
                raise InputError(f"it holds what the database cannot store: {error.orig}") from error
            except DBAPIError as error:
                if committing and _is_lost(error):
                    log.warning("commit lost", error=str(error.orig))
                    raise StorageError("the database went away; it is not known whether this was stored") from error
                if not (_is_lost(error) or _sqlstate(error) in _ROLLED_BACK) or not pauses.pause():
                    raise

    def _snapshot(self, work: Callable[[Connection], R]) -> R:
        pauses = _Pauses(self._wait_s, self._ending)
        while True:
            try:
                with self.reader.connect() as connection:
                    return work(connection)
            except DataError as error:
                raise InputError(f"it names what the database cannot store: {error.orig}") from error
            except DBAPIError as error:
                if not _is_lost(error) or not pauses.pause():
                    raise

    def _room(self) -> Room:
        query = text("SELECT pg_database_size(current_database())")
        return Room(int(self._snapshot(lambda connection: connection.execute(query).scalar_one())))

    def _close(self) -> None:
        self._ending.set()
        for thread in (self._teller, self._listener):
            if thread is not None:
                thread.stop()
        super()._close()

    def _connect_aside(self) -> psycopg.Connection[Any]:
        """A connection of no pool, for signals; its commits need no disk."""
        import psycopg

        args, kwargs = self.writer.dialect.create_connect_args(self.writer.url)
        options = "-c synchronous_commit=off"
        return psycopg.connect(*args, **kwargs, autocommit=True, options=options, keepalives_idle=5, keepalives_count=3)

    def _engine(self, connections: int) -> Engine:
        wait_ms, idle_ms = int(self._wait_s * 1000), int(self._idle_s * 1000)
        given = {
            "synchronous_commit": "on",
            "lock_timeout": wait_ms,
            "idle_in_transaction_session_timeout": idle_ms,
        }
        return create_engine(
            self._url,
            pool_size=connections,
            max_overflow=0,
            execution_options={SENDER: self._sender},
            connect_args={
                "options": " ".join(f"-c {name}={value}" for name, value in given.items()),
                "application_name": "skypose",
                "connect_timeout": max(2, int(self._wait_s)),
                "keepalives_idle": 5,
                "keepalives_interval": 2,
                "keepalives_count": 3,
                "tcp_user_timeout": wait_ms,
            },
        )


def looking(url: str) -> Engine:
    """An engine that only reads; nothing is migrated. Raises ``ConfigError`` for a URL that cannot be one."""
    engine = create_engine(_checked(url), pool_size=1, max_overflow=0)
    return engine.execution_options(isolation_level="REPEATABLE READ", postgresql_readonly=True)


class _Pauses:
    """Pauses between tries, longer and longer, until the time is over or the database is closed."""

    def __init__(self, wait_s: float, ending: threading.Event) -> None:
        self._until = time.monotonic() + wait_s
        self._ending = ending
        self._pause_s = _FIRST_PAUSE_S

    def pause(self) -> bool:
        """Wait. Returns whether there is time for another try."""
        pause_s = self._pause_s * random.uniform(0.5, 1.0)  # two that stood in each other's way do not do so again
        self._pause_s = min(2 * self._pause_s, _LONGEST_PAUSE_S)
        if time.monotonic() + pause_s >= self._until:
            return False
        return not self._ending.wait(pause_s)


def _checked(url: str) -> Any:
    try:
        parsed = make_url(url)
    except ArgumentError as error:
        raise ConfigError("this is no database URL", field="SKYPOSE_DATABASE_URL") from error
    if parsed.drivername not in (DRIVER, "postgresql"):
        raise ConfigError(f"only {DRIVER}://... (empty: SQLite) is taken", field="SKYPOSE_DATABASE_URL")
    try:
        import psycopg  # noqa: F401 -- only to say what is missing
    except ImportError as error:
        raise ConfigError(
            "PostgreSQL needs a driver: pip install 'psycopg[binary]'", field="SKYPOSE_DATABASE_URL"
        ) from error
    return parsed.set(drivername=DRIVER)


def _migrate(connection: Connection) -> None:
    connection.execute(text("SELECT pg_advisory_xact_lock(:key)"), {"key": _MIGRATING})  # several start at once
    migrate(connection)


def _sqlstate(error: DBAPIError) -> str | None:
    state: str | None = getattr(error.orig, "sqlstate", None)
    return state


def _is_lost(error: DBAPIError) -> bool:
    """Whether the connection failed, rather than a statement on it."""
    state = _sqlstate(error)
    if state is None:
        return error.connection_invalidated or isinstance(error, OperationalError)
    return state in _LOST or state.startswith("08")

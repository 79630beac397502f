"""NOTIFY beside the frames' transactions: one connection of its own, in a thread, for what all of them have to say.

A commit with a NOTIFY holds a lock of the whole server, so that no two of them share a write to disk. What is told here
costs the frames nothing: it goes out at once while little is said, and otherwise together, some tens of times a second.
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import structlog

from service.store.signals import CHANNEL, Signal, payload

if TYPE_CHECKING:
    import psycopg

log = structlog.get_logger(__name__)
PAUSE_S = 0.02
_SEND = "SELECT pg_notify(%s, said) FROM unnest(%s::text[]) AS said"


class Teller:
    """Tells the other processes how far logs have grown. What is lost with the connection or the process, they read."""

    def __init__(self, connect: Callable[[], psycopg.Connection[Any]], sender: str) -> None:
        self._connect = connect
        self._sender = sender
        self._lock = threading.Lock()
        self._waiting: dict[str, Signal] = {}  # by session: the newest says all
        self._woken = threading.Event()
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self._run, name="store-tell", daemon=True)

    def start(self) -> None:
        """Begin."""
        self._thread.start()

    def stop(self) -> None:
        """Tell what is left, end, and wait for it."""
        self._stopping.set()
        self._woken.set()
        self._thread.join()

    def tell(self, signal: Signal) -> None:
        """Send soon. From any thread; never waits for the server."""
        with self._lock:
            self._waiting[signal.key] = signal
        self._woken.set()

    def _run(self) -> None:
        import psycopg

        connection: psycopg.Connection[Any] | None = None
        ending = False
        while not ending:
            self._woken.wait()
            self._woken.clear()
            ending = self._stopping.is_set()
            try:
                connection = connection or self._connect()
                self._send(connection)
            except psycopg.Error as error:
                log.warning("signals to other processes lost; they read the log", error=str(error))
                if connection is not None:
                    connection.close()
                connection = None
            self._stopping.wait(PAUSE_S)
        if connection is not None:
            connection.close()

    def _send(self, connection: psycopg.Connection[Any]) -> None:
        with self._lock:
            waiting, self._waiting = self._waiting, {}
        said = [payload(self._sender, signal) for signal in waiting.values()]
        if said:
            connection.execute(_SEND, (CHANNEL, said))

"""LISTEN: one connection of its own, in a thread, that comes back whenever the server does."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import structlog

from service.store.signals import CHANNEL, Heard, received

if TYPE_CHECKING:
    import psycopg

log = structlog.get_logger(__name__)
_LOOK_S = 0.5
_AGAIN_S = 0.2


class Listener:
    """Hears what others send. ``heard`` and ``resumed`` are called in its thread."""

    def __init__(
        self,
        connect: Callable[[], psycopg.Connection[Any]],
        sender: str,
        heard: Heard,
        resumed: Callable[[], None],
    ) -> None:
        self._connect = connect
        self._sender = sender
        self._heard = heard
        self._resumed = resumed
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self._run, name="store-listen", daemon=True)

    def start(self) -> None:
        """Begin."""
        self._thread.start()

    def stop(self) -> None:
        """End, and wait for it."""
        self._stopping.set()
        self._thread.join()

    def _run(self) -> None:
        import psycopg

        heard = True
        while not self._stopping.is_set():
            try:
                with self._connect() as connection:
                    connection.execute(f"LISTEN {CHANNEL}")
                    heard = True
                    self._resumed()
                    while not self._stopping.is_set():
                        self._hear(connection)
            except psycopg.Error as error:
                if heard:
                    log.warning("signals of other processes not heard; tried again and again", error=str(error))
                heard = False
                self._stopping.wait(_AGAIN_S)

    def _hear(self, connection: psycopg.Connection[Any]) -> None:
        for notify in connection.notifies(timeout=_LOOK_S):
            message = received(notify.payload)
            if message is not None and message[0] != self._sender:
                self._heard(message[1])
            if self._stopping.is_set():
                return

"""The stream's messages, and where a watcher stands in them: what lets a stream be resumed without loss or repeat."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal, cast
from urllib.parse import urlencode

import orjson

from service.api.schemas import Estimate
from service.remote.errors import UnexpectedError

Type = Literal["estimate", "heartbeat", "resync-required", "end"]
_TYPES = ("estimate", "heartbeat", "resync-required", "end")


@dataclass(frozen=True)
class Event:
    """A message of the stream."""

    type: Type
    seq: int
    """Number of the newest event when it was sent; a stream resumes ``after`` it."""
    estimate: Estimate | None = None
    """Of an ``estimate``."""
    reason: str | None = None
    """Of an ``end``."""


def read_event(text: str | bytes) -> Event:
    """A message as it is sent. Raises ``UnexpectedError``."""
    try:
        document: Any = orjson.loads(text)
        kind, seq = document["type"], int(document["seq"])
        if kind not in _TYPES:
            raise UnexpectedError(f"the stream sent a message of type {kind!r}")
        estimate = None
        if kind == "estimate":
            estimate = Estimate.model_validate(document["estimate"], extra="ignore")
        return Event(cast(Type, kind), seq, estimate, document.get("reason"))
    except (orjson.JSONDecodeError, KeyError, TypeError, ValueError) as error:
        raise UnexpectedError(f"the stream sent what is no message: {error}") from error


class Cursor:
    """Where a watcher stands. One stream after the other is opened at ``query`` until a message ends it."""

    def __init__(self, after: int, *, heartbeats: bool = False) -> None:
        self.after = after
        self.ended = False
        self._heartbeats = heartbeats

    @property
    def query(self) -> str:
        """Of the address at which the next stream begins."""
        return urlencode({"after": self.after})

    def take(self, event: Event) -> bool:
        """Note a message; whether the watcher should hear of it.

        The end of a service that stops is not the session's: the stream is opened again when the service is back.
        """
        self.after = event.seq
        if event.type == "end" and event.reason == "shutdown":
            return False
        self.ended = event.type == "end"
        return self._heartbeats or event.type != "heartbeat"


class ServerSentEvents:
    """Takes a ``text/event-stream`` apart, line by line (WHATWG HTML, section 9.2)."""

    def __init__(self) -> None:
        self._data: list[str] = []

    def feed(self, line: str) -> Event | None:
        """The event that this line completes, if it does. Raises ``UnexpectedError``."""
        if line == "":
            data, self._data = "\n".join(self._data), []
            return read_event(data) if data else None
        if line.startswith("data:"):
            self._data.append(line[5:].removeprefix(" "))
        return None

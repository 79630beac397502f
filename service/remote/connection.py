"""Sends calls and follows streams, sync. ``aio`` is the same with ``await``; what they decide is in ``retries``."""

from __future__ import annotations

from collections.abc import Callable, Generator, Iterator, Mapping
from contextlib import closing, contextmanager
from typing import Any, TypeVar

import httpx
from websockets.sync.client import connect

from service.api.schemas import Estimate
from service.remote import sockets
from service.remote.batch import BatchLines
from service.remote.calls import Call, P, page
from service.remote.errors import RefusedError
from service.remote.events import Cursor, Event, ServerSentEvents, read_event
from service.remote.options import StreamKind
from service.remote.retries import Attempts, Retries, TryLaterError

T = TypeVar("T")
ENDED_EARLY = "the stream ended before the session did"


class Connection:
    """Owns the HTTP client."""

    def __init__(self, http: httpx.Client, retries: Retries, stale_s: float, sleep: Callable[[float], None]) -> None:
        self._http = http
        self._retries = retries
        self._stale_s = stale_s
        self._sleep = sleep

    def close(self) -> None:
        """Let the connections go."""
        self._http.close()

    def call(self, call: Call[T]) -> T:
        """The answer. Raises ``ClientError`` or ``httpx.TransportError``."""
        attempts = Attempts(self._retries, repeatable=call.repeatable)
        while True:
            try:
                response = self._http.send(call.request(self._http))
                pause_s = attempts.after_answer(response)
            except httpx.TransportError as error:
                pause_s = attempts.after_break(error)
            except RefusedError as error:
                return call.refused(error, attempts.failures)
            else:
                if pause_s is None:
                    return call.read(response)
            self._sleep(pause_s)

    def pages(self, kind: type[P], path: str, params: Mapping[str, Any]) -> Iterator[P]:
        """A list, page by page."""
        url: str | None = path
        while url is not None:
            found = self.call(page(kind, url, params))
            yield found
            url, params = found.next, {}

    def track(self, call: Call[Estimate]) -> Iterator[Estimate]:
        """The estimates of a file of several frames, as they come."""
        attempts, lines = Attempts(self._retries, repeatable=call.repeatable), BatchLines()
        while True:
            lines.restart()
            try:
                with self._stream(call.request(self._http)) as response:
                    pause_s = attempts.after_answer(response)
                    if pause_s is None:
                        for line in response.iter_lines():
                            estimate = lines.take(line)
                            attempts.succeeded()
                            if estimate is not None:
                                yield estimate
                        return
            except httpx.TransportError as error:
                pause_s = attempts.after_break(error)
            except RefusedError as error:
                pause_s = attempts.after_refusal(error)
            self._sleep(pause_s)

    def watch(self, session_id: str, cursor: Cursor, over: StreamKind) -> Iterator[Event]:
        """Events from the cursor on, across any number of streams."""
        attempts = Attempts(self._retries, repeatable=True)
        messages = self._socket_events if over == "websocket" else self._sent_events
        while True:
            try:
                with closing(messages(session_id, cursor, attempts)) as events:
                    for event in events:
                        attempts.succeeded()
                        if cursor.take(event):
                            yield event
                if cursor.ended:
                    return
                pause_s = attempts.after_break(httpx.ReadError(ENDED_EARLY))
            except TryLaterError as later:
                pause_s = later.pause_s
            except httpx.TransportError as error:
                pause_s = attempts.after_break(error)
            self._sleep(pause_s)

    def _sent_events(self, session_id: str, cursor: Cursor, attempts: Attempts) -> Generator[Event]:
        request = self._http.build_request(
            "GET",
            f"/v1/sessions/{session_id}/events?{cursor.query}",
            timeout=httpx.Timeout(self._http.timeout.connect, read=self._stale_s),
        )
        with self._stream(request) as response:
            pause_s = attempts.after_answer(response)
            if pause_s is not None:
                raise TryLaterError(pause_s)
            sent = ServerSentEvents()
            for line in response.iter_lines():
                event = sent.feed(line)
                if event is not None:
                    yield event

    def _socket_events(self, session_id: str, cursor: Cursor, attempts: Attempts) -> Generator[Event]:
        url = sockets.socket_url(self._http.base_url, session_id, cursor.query)
        options = sockets.socket_options(self._http.headers)
        try:
            with connect(url, **options) as socket:
                while not cursor.ended:
                    yield read_event(socket.recv(timeout=self._stale_s))
        except sockets.Broken as error:
            answer = sockets.denial(error)
            pause_s = None if answer is None else attempts.after_answer(answer)
            if pause_s is None:
                raise sockets.as_transport_error(error) from error
            raise TryLaterError(pause_s) from error

    @contextmanager
    def _stream(self, request: httpx.Request) -> Iterator[httpx.Response]:
        response = self._http.send(request, stream=True)
        try:
            if response.is_error:
                response.read()
            yield response
        finally:
            response.close()

"""Sends calls and follows streams, async: ``connection`` with ``await``."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncGenerator, Awaitable, Callable, Mapping
from contextlib import aclosing, asynccontextmanager
from typing import Any, TypeVar

import httpx
from websockets.asyncio.client import connect

from service.api.schemas import Estimate
from service.remote import sockets
from service.remote.batch import BatchLines
from service.remote.calls import Call, P, page
from service.remote.connection import ENDED_EARLY
from service.remote.errors import RefusedError
from service.remote.events import Cursor, Event, ServerSentEvents, read_event
from service.remote.options import StreamKind
from service.remote.retries import Attempts, Retries, TryLaterError

T = TypeVar("T")


class AsyncConnection:
    """Owns the HTTP client."""

    def __init__(
        self, http: httpx.AsyncClient, retries: Retries, stale_s: float, sleep: Callable[[float], Awaitable[None]]
    ) -> None:
        self._http = http
        self._retries = retries
        self._stale_s = stale_s
        self._sleep = sleep

    async def aclose(self) -> None:
        """Let the connections go."""
        await self._http.aclose()

    async def call(self, call: Call[T]) -> T:
        """The answer. Raises ``ClientError`` or ``httpx.TransportError``."""
        attempts = Attempts(self._retries, repeatable=call.repeatable)
        while True:
            try:
                response = await self._http.send(call.request(self._http))
                pause_s = attempts.after_answer(response)
            except httpx.TransportError as error:
                pause_s = attempts.after_break(error)
            except RefusedError as error:
                return call.refused(error, attempts.failures)
            else:
                if pause_s is None:
                    return call.read(response)
            await self._sleep(pause_s)

    async def pages(self, kind: type[P], path: str, params: Mapping[str, Any]) -> AsyncGenerator[P]:
        """A list, page by page."""
        url: str | None = path
        while url is not None:
            found = await self.call(page(kind, url, params))
            yield found
            url, params = found.next, {}

    async def track(self, call: Call[Estimate]) -> AsyncGenerator[Estimate]:
        """The estimates of a file of several frames, as they come."""
        attempts, lines = Attempts(self._retries, repeatable=call.repeatable), BatchLines()
        while True:
            lines.restart()
            try:
                async with self._stream(call.request(self._http)) as response:
                    pause_s = attempts.after_answer(response)
                    if pause_s is None:
                        async for line in response.aiter_lines():
                            estimate = lines.take(line)
                            attempts.succeeded()
                            if estimate is not None:
                                yield estimate
                        return
            except httpx.TransportError as error:
                pause_s = attempts.after_break(error)
            except RefusedError as error:
                pause_s = attempts.after_refusal(error)
            await self._sleep(pause_s)

    async def watch(self, session_id: str, cursor: Cursor, over: StreamKind) -> AsyncGenerator[Event]:
        """Events from the cursor on, across any number of streams."""
        attempts = Attempts(self._retries, repeatable=True)
        messages = self._socket_events if over == "websocket" else self._sent_events
        while True:
            try:
                async with aclosing(messages(session_id, cursor, attempts)) as events:
                    async for event in events:
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
            await self._sleep(pause_s)

    async def _sent_events(self, session_id: str, cursor: Cursor, attempts: Attempts) -> AsyncGenerator[Event]:
        request = self._http.build_request(
            "GET",
            f"/v1/sessions/{session_id}/events?{cursor.query}",
            timeout=httpx.Timeout(self._http.timeout.connect, read=self._stale_s),
        )
        async with self._stream(request) as response:
            pause_s = attempts.after_answer(response)
            if pause_s is not None:
                raise TryLaterError(pause_s)
            sent = ServerSentEvents()
            async for line in response.aiter_lines():
                event = sent.feed(line)
                if event is not None:
                    yield event

    async def _socket_events(self, session_id: str, cursor: Cursor, attempts: Attempts) -> AsyncGenerator[Event]:
        url = sockets.socket_url(self._http.base_url, session_id, cursor.query)
        options = sockets.socket_options(self._http.headers)
        try:
            async with connect(url, **options) as socket:
                while not cursor.ended:
                    yield read_event(await asyncio.wait_for(socket.recv(), self._stale_s))
        except sockets.Broken as error:
            answer = sockets.denial(error)
            pause_s = None if answer is None else attempts.after_answer(answer)
            if pause_s is None:
                raise sockets.as_transport_error(error) from error
            raise TryLaterError(pause_s) from error

    @asynccontextmanager
    async def _stream(self, request: httpx.Request) -> AsyncGenerator[httpx.Response]:
        response = await self._http.send(request, stream=True)
        try:
            if response.is_error:
                await response.aread()
            yield response
        finally:
            await response.aclose()

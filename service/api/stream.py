"""The live stream of a session: WebSocket, and the same as server-sent events."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncGenerator, Coroutine, Iterable
from typing import Annotated, Any

import orjson
import structlog
from fastapi import APIRouter, Header, Query, Response, WebSocket
from pydantic import BaseModel, ConfigDict, Field
from starlette.types import Receive, Scope, Send
from starlette.websockets import WebSocketDisconnect, WebSocketState

from service.access.principal import Principal, SessionKey
from service.api.auth import Reader, ReadSession, admit
from service.api.paging import problems
from service.api.problems import problem_response
from service.api.services import Services, ServicesDep, services_of
from service.errors import InputError, SkyposeError
from service.sessions.hub import Message
from service.sessions.near import did_you_mean

log = structlog.get_logger(__name__)
router = APIRouter(prefix="/v1/sessions/{session_id}", tags=["stream"])
_LAST = {"type": "http.response.body", "body": b"", "more_body": False}
CLOSE_NORMAL, CLOSE_GOING_AWAY, CLOSE_POLICY, CLOSE_TRY_AGAIN = 1000, 1001, 1008, 1013


class StreamQuery(BaseModel):
    """Where a stream begins."""

    model_config = ConfigDict(extra="forbid", use_attribute_docstrings=True)

    after: Annotated[int, Field(ge=-1, le=2**53)] | None = None
    """Events after this number"""
    ticket: str | None = None
    """From `POST /v1/tickets`, in the place of a key"""


@router.get(
    "/events",
    response_class=Response,
    responses={200: {"content": {"text/event-stream": {}}}, **problems(404, 422, 503)},
)
async def events(
    session: ReadSession,
    caller: Reader,
    services: ServicesDep,
    query: Annotated[StreamQuery, Query()],
    last_event_id: Annotated[str | None, Header(description="Wins over `after`: a resumed stream")] = None,
) -> Response:
    """Estimates as they come. `after=0` begins with the first; without it only new ones are sent."""
    after = query.after
    if last_event_id:
        after = _number(last_event_id, "header:Last-Event-ID")
    return EventStream(services, caller, session, after)


@router.websocket("/stream")
async def stream(websocket: WebSocket, session_id: str) -> None:
    """The same as `events`; `?after=N` resumes. What a client sends is ignored."""
    services = services_of(websocket)
    try:
        caller = await admit(websocket)
        _require_known(websocket.query_params)
        text = websocket.query_params.get("after")
        after = None if text is None else _number(text, "query:after")
        async with services.hub.watch(caller.session(session_id), after) as messages:
            await websocket.accept()
            timeout_s = services.settings.stream_send_timeout_s
            await _first(
                _send_all(websocket, messages, timeout_s),
                _until_gone(websocket),
                _until_ended(websocket, services, caller),
            )
    except SkyposeError as error:
        services.metrics.refusals.labels(error.slug).inc()
        if websocket.application_state is WebSocketState.CONNECTING:
            await websocket.send_denial_response(problem_response(error))
        else:
            await websocket.close(CLOSE_TRY_AGAIN, error.title)


async def _send_all(websocket: WebSocket, messages: AsyncGenerator[Message], timeout_s: float) -> None:
    async for message in messages:
        await asyncio.wait_for(websocket.send_text(message_json(message).decode()), timeout_s)
        if message.type == "end":
            code = CLOSE_GOING_AWAY if message.reason == "shutdown" else CLOSE_NORMAL
            await websocket.close(code, message.reason)


async def _until_ended(websocket: WebSocket, services: Services, caller: Principal) -> None:
    await services.gate.until_ended(caller)
    await websocket.close(CLOSE_POLICY, "the credential is no longer good")


async def _until_gone(websocket: WebSocket) -> None:
    while True:
        await websocket.receive()  # raises RuntimeError once the client has gone


class EventStream(Response):
    """A response that goes on until the session or the client ends."""

    media_type = "text/event-stream"

    def __init__(self, services: Services, caller: Principal, session: SessionKey, after: int | None) -> None:
        super().__init__(headers={"Cache-Control": "no-store", "X-Accel-Buffering": "no"})
        del self.headers["content-length"]
        self._services = services
        self._caller = caller
        self._session = session
        self._after = after

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Send the head, then every message."""
        async with self._services.hub.watch(self._session, self._after) as messages:
            await send({"type": "http.response.start", "status": 200, "headers": self.raw_headers})
            await _first(self._send_all(messages, send), _until_disconnected(receive), self._until_ended(send))

    async def _until_ended(self, send: Send) -> None:
        await self._services.gate.until_ended(self._caller)
        await send(_LAST)

    async def _send_all(self, messages: AsyncGenerator[Message], send: Send) -> None:
        timeout_s = self._services.settings.stream_send_timeout_s
        async for message in messages:
            head = f"id: {message.seq}\nevent: {message.type}\ndata: ".encode()
            body = head + message_json(message) + b"\n\n"
            await asyncio.wait_for(send({"type": "http.response.body", "body": body, "more_body": True}), timeout_s)
        await send(_LAST)


async def _until_disconnected(receive: Receive) -> None:
    while (await receive())["type"] != "http.disconnect":
        pass


async def _first(*work: Coroutine[Any, Any, None]) -> None:
    """Run until the first ends, cancel the others. A client that left or stalled is no error."""
    tasks = [asyncio.create_task(item) for item in work]
    try:
        await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
    finally:
        for task in tasks:
            task.cancel()
        ended = await asyncio.gather(*tasks, return_exceptions=True)
    for result in ended:
        if isinstance(result, TimeoutError):
            log.info("watcher let go: it took nothing for too long")
        elif isinstance(result, Exception) and not isinstance(result, WebSocketDisconnect | RuntimeError | OSError):
            raise result


def message_json(message: Message) -> bytes:
    """A message as clients get it."""
    head = b'{"type":"' + message.type.encode() + b'","seq":' + str(message.seq).encode()
    if message.document is not None:
        return head + b',"estimate":' + message.document + b"}"
    if message.reason is not None:
        return head + b',"reason":' + orjson.dumps(message.reason) + b"}"
    return head + b"}"


def _require_known(names: Iterable[str]) -> None:
    """A WebSocket's query is not checked by the framework."""
    for name in names:
        if name not in StreamQuery.model_fields:
            near = did_you_mean((), name, StreamQuery.model_json_schema())
            raise InputError(f"no such parameter{near}", field=f"query:{name}")


def _number(text: str, field: str) -> int:
    try:
        number = int(text)
    except ValueError as error:
        raise InputError("must be the number of an event", field=field) from error
    if not -1 <= number <= 2**53:
        raise InputError("must be the number of an event", field=field)
    return number

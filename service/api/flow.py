"""How much is under way at once, and that it moves: nothing waits in memory for a client that does not read or send."""

from __future__ import annotations

import asyncio

import structlog
from starlette.requests import ClientDisconnect, Request
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from service.api.problems import problem_response
from service.api.services import services_of
from service.errors import BusyError, SlowBodyError
from service.sessions.admission import Places
from service.settings import Settings

log = structlog.get_logger(__name__)
CHUNK_BYTES = 1 << 18
# Answers that may be many megabytes; so many at a time, and each holds its place until the client has taken it.
_HEAVY = (
    "/overlay.png",
    "/frame.png",
    "/model.png",
    "/residual.png",
    "/frame.fits",
    "/particles",
    "/estimates",
    "/export",
    "/checkpoint",
    "/mesh.glb",
)
_STREAM = "/events"


class StalledError(Exception):
    """The client takes nothing. Never leaves this module: there is nobody left to tell."""


class Flow:
    """ASGI middleware: bounds the calls under way, and lets go of clients that neither send nor take."""

    def __init__(self, app: ASGIApp, settings: Settings) -> None:
        self._app = app
        self._send_timeout_s = settings.stream_send_timeout_s
        self._body_timeout_s = settings.body_timeout_s
        self._calls = Places(settings.max_calls, "SKYPOSE_MAX_CALLS")
        self._heavy = Places(settings.max_heavy_reads, "SKYPOSE_MAX_HEAVY_READS")
        self._streams = Places(settings.max_streams, "SKYPOSE_MAX_STREAMS")

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass on where there is room, else answer 503 at once."""
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        try:
            with self._place(scope).take():
                await self._app(scope, self._timed(receive), self._paced(send))
        except BusyError as error:
            services_of(Request(scope)).metrics.refusals.labels(error.slug).inc()
            await problem_response(error)(scope, receive, send)
        except ClientDisconnect:
            log.info("client left in the middle of its body", path=scope["path"])
        except StalledError:
            log.info("client let go: it took nothing for too long", path=scope["path"])

    def _place(self, scope: Scope) -> Places:
        path, reads = scope["path"], scope["method"] == "GET"
        if reads and path.endswith(_STREAM):
            return self._streams
        return self._heavy if reads and path.endswith(_HEAVY) else self._calls

    def _timed(self, receive: Receive) -> Receive:
        """While a body is coming, silence has an end."""
        complete = False

        async def timed() -> Message:
            nonlocal complete
            if complete:  # from here on it tells when the client goes away, which may be never
                return await receive()
            try:
                async with asyncio.timeout(self._body_timeout_s):
                    message = await receive()
            except TimeoutError as error:
                raise SlowBodyError(
                    f"nothing came for {self._body_timeout_s:g} s in the middle of the body",
                    field="body",
                    limit=self._body_timeout_s,
                    setting="SKYPOSE_BODY_TIMEOUT_S",
                ) from error
            complete = not message.get("more_body", False)
            return message

        return timed

    def _paced(self, send: Send) -> Send:
        """In pieces, so that what the client has not taken yet is not copied into the connection's buffer."""

        async def timed(message: Message) -> None:
            try:
                async with asyncio.timeout(self._send_timeout_s):
                    await send(message)
            except TimeoutError as error:
                raise StalledError from error

        async def paced(message: Message) -> None:
            body = message.get("body", b"")
            if len(body) <= CHUNK_BYTES:
                await timed(message)
                return
            for start in range(0, len(body), CHUNK_BYTES):
                more = message.get("more_body", False) or start + CHUNK_BYTES < len(body)
                await timed({**message, "body": body[start : start + CHUNK_BYTES], "more_body": more})

        return paced

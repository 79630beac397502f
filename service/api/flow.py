"""How much is under way at once, and that it moves: nothing waits in memory for a client that does not read or send.

A call takes its place when it is known who calls (``service.api.auth``), so nobody without a credential holds one.
"""

from __future__ import annotations

import asyncio
import time
from contextlib import ExitStack

import structlog
from starlette.requests import ClientDisconnect, Request
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from service.access.principal import Principal
from service.access.under_way import UnderWay
from service.api.auth import ENTER
from service.api.problems import problem_response
from service.api.services import services_of
from service.errors import BusyError, SlowBodyError
from service.sessions.admission import Places
from service.settings import Settings

log = structlog.get_logger(__name__)
PROBES = ("/healthz", "/readyz", "/metrics")  # which must be answered when nothing else is
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
    "/report",
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
        self._body_bytes_per_s = settings.body_kb_per_s * 1024
        self._under_way = UnderWay(settings)
        self._calls = Places(settings.max_calls, "SKYPOSE_MAX_CALLS")
        self._pages = Places(settings.max_page_files, "SKYPOSE_MAX_PAGE_FILES")
        self._heavy = Places(settings.max_heavy_reads, "SKYPOSE_MAX_HEAVY_READS")
        self._streams = Places(settings.max_streams, "SKYPOSE_MAX_STREAMS")

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass on where there is room, else answer at once."""
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        try:
            with ExitStack() as held:
                if scope["path"].startswith("/v1/"):
                    scope.setdefault("state", {})[ENTER] = lambda caller: self._enter(held, scope, caller)
                elif scope["path"] not in PROBES:
                    held.enter_context(self._pages.take())
                await self._app(scope, self._timed(receive), self._paced(send))
        except BusyError as error:
            services_of(Request(scope)).metrics.refusals.labels(error.slug).inc()
            await problem_response(error)(scope, receive, send)
        except ClientDisconnect:
            log.info("client left in the middle of its body", path=scope["path"])
        except StalledError:
            log.info("client let go: it took nothing for too long", path=scope["path"])

    def _enter(self, held: ExitStack, scope: Scope, caller: Principal) -> None:
        """Take the caller's own place and the service's, until the call ends."""
        path, reads = scope["path"], scope["method"] == "GET"
        if reads and path.endswith(_STREAM):  # the hub counts those of a tenant
            held.enter_context(self._streams.take())
            return
        heavy = reads and path.endswith(_HEAVY)
        held.enter_context(self._under_way.take(caller, heavy=heavy))
        held.enter_context((self._heavy if heavy else self._calls).take())

    def _timed(self, receive: Receive) -> Receive:
        """While a body is coming, silence has an end, and so has a trickle."""
        complete, came, waited_s = False, 0, 0.0

        async def timed() -> Message:
            nonlocal complete, came, waited_s
            if complete:  # from here on it tells when the client goes away, which may be never
                return await receive()
            began = time.monotonic()
            behind_s = self._behind_s(came, waited_s)
            try:
                async with asyncio.timeout(self._body_timeout_s - behind_s):
                    message = await receive()
            except TimeoutError as error:
                raise self._too_slow(behind_s) from error
            waited_s += time.monotonic() - began
            came += len(message.get("body", b""))
            complete = not message.get("more_body", False)
            return message

        return timed

    def _behind_s(self, came: int, waited_s: float) -> float:
        """How far a body is behind the least rate, after so many bytes in so many seconds of waiting for it."""
        return max(waited_s - came / self._body_bytes_per_s, 0.0) if self._body_bytes_per_s else 0.0

    def _too_slow(self, behind_s: float) -> SlowBodyError:
        if behind_s:
            least = self._body_bytes_per_s / 1024
            detail, setting = f"less than {least:g} KiB/s of the body came", "SKYPOSE_BODY_KB_PER_S"
            return SlowBodyError(detail, field="body", limit=least, setting=setting)
        silence_s = self._body_timeout_s
        detail, setting = f"nothing came for {silence_s:g} s in the middle of the body", "SKYPOSE_BODY_TIMEOUT_S"
        return SlowBodyError(detail, field="body", limit=silence_s, setting=setting)

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

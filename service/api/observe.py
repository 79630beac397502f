"""One log line, one measurement and one request id per HTTP call."""

from __future__ import annotations

import time
import uuid

import structlog
from starlette.datastructures import Headers, MutableHeaders
from starlette.requests import Request
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from service.access.principal import Principal
from service.api.auth import PRINCIPAL
from service.api.services import services_of

log = structlog.get_logger(__name__)
_METHODS = ("GET", "HEAD", "POST", "PUT", "DELETE", "OPTIONS", "PATCH")
CLIENT_LEFT = 499  # nobody is there to be answered; as nginx counts them
_QUIET = ("/healthz", "/readyz", "/metrics", "/static")


class Observe:
    """ASGI middleware. The request id is the client's X-Request-ID where it sent a sane one."""

    def __init__(self, app: ASGIApp) -> None:
        self._app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass on; log and measure when the answer has gone out."""
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        request_id = _request_id(Headers(scope=scope).get("x-request-id", ""))
        started, status = time.perf_counter(), CLIENT_LEFT

        async def marked(message: Message) -> None:
            nonlocal status
            if message["type"] == "http.response.start":
                status = message["status"]
                MutableHeaders(scope=message)["X-Request-ID"] = request_id
            await send(message)

        with structlog.contextvars.bound_contextvars(request_id=request_id):
            try:
                await self._app(scope, receive, marked)
            except Exception:
                status = 500
                raise
            finally:
                self._note(scope, status, time.perf_counter() - started)

    def _note(self, scope: Scope, status: int, seconds: float) -> None:
        path = getattr(scope.get("route"), "path", "(none)")
        metrics = services_of(Request(scope)).metrics
        method = scope["method"] if scope["method"] in _METHODS else "other"  # a client may invent any
        metrics.request_seconds.labels(method, path, str(status)).observe(seconds)
        if not scope["path"].startswith(_QUIET):
            caller: Principal | None = scope.get("state", {}).get(PRINCIPAL)
            who = {} if caller is None else {"tenant": caller.tenant, "key": caller.key_id}
            ms = round(seconds * 1e3, 1)
            log.info("call", method=scope["method"], path=scope["path"], status=status, ms=ms, **who)


def _request_id(given: str) -> str:
    if 1 <= len(given) <= 100 and given.isascii() and given.isprintable():
        return given
    return uuid.uuid4().hex

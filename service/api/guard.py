"""What holds for every answer: security headers, and an entry in the audit log where it belongs there."""

from __future__ import annotations

import base64
import hashlib
import re
from pathlib import Path

import structlog
from starlette.datastructures import MutableHeaders
from starlette.requests import HTTPConnection
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from service.access.audit import Entry
from service.access.peers import FORWARDED
from service.access.principal import Principal
from service.api.auth import PRINCIPAL
from service.api.services import Services, services_of

_INLINE_SCRIPT = re.compile(r"<script(?![^>]*\ssrc=)[^>]*>(.*?)</script>", re.S)
_API_POLICY = "default-src 'none'; frame-ancestors 'none'"
_HEADERS = {
    "X-Content-Type-Options": "nosniff",
    "X-Frame-Options": "DENY",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Permissions-Policy": "camera=(), geolocation=(), microphone=()",
}
# Frames and backgrounds are in their session's own history: one entry each would bury the rest.
_NOT_AUDITED = ("/frames", "/frames/{index}", "/background", "/tickets")
_AUDITED_READS = ("/checkpoint", "/export", "/report")  # which carry a whole session away
_CREDENTIAL_STATUSES = (401, 403)


def page_policy(html: str, *, style: str = "'self'") -> str:
    """Content-Security-Policy of a page: what comes from here, and the inline scripts it has now, by their hash."""
    hashes = [
        base64.b64encode(hashlib.sha256(text.encode()).digest()).decode() for text in _INLINE_SCRIPT.findall(html)
    ]
    scripts = " ".join(["'self'", *(f"'sha256-{digest}'" for digest in hashes)])
    return (
        f"default-src 'none'; script-src {scripts}; style-src {style}; img-src 'self' data: blob:; connect-src 'self'; "
        "font-src 'self'; media-src 'self' blob:; worker-src 'self' blob:; manifest-src 'self'; "
        "base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
    )


class Guard:
    """ASGI middleware, the outermost but for the log. ``pages``: path -> Content-Security-Policy."""

    def __init__(self, app: ASGIApp, pages: dict[str, str]) -> None:
        self._app = app
        self._pages = pages

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass on, with the headers on the answer."""
        if scope["type"] not in ("http", "websocket"):
            await self._app(scope, receive, send)
            return
        policy = self._pages.get(scope["path"], _API_POLICY)
        status = 500 if scope["type"] == "http" else 101

        async def marked(message: Message) -> None:
            nonlocal status
            if message["type"] in ("http.response.start", "websocket.http.response.start"):
                status = message["status"]
                _mark(MutableHeaders(scope=message), policy, private=scope["path"].startswith("/v1/"))
            await send(message)

        try:
            await self._app(scope, receive, marked)
        finally:
            _audit(services_of(HTTPConnection(scope)), scope, status)


def _mark(headers: MutableHeaders, policy: str, *, private: bool) -> None:
    for name, value in _HEADERS.items():
        headers[name] = value
    headers.setdefault("Content-Security-Policy", policy)
    if private:
        headers.add_vary_header("Authorization")
        headers.setdefault("Cache-Control", "no-store")


def _audit(services: Services, scope: Scope, status: int) -> None:
    route = getattr(scope.get("route"), "path", "")
    state = scope.get("state", {})
    if not route.startswith(("/v1/", "/metrics")) or state.get(FORWARDED):  # that is noted where the call came in
        return
    method = scope.get("method", "WS")
    reads = method in ("GET", "HEAD", "OPTIONS", "WS")
    changes = not reads and not route.endswith(_NOT_AUDITED)
    if not (changes or status in _CREDENTIAL_STATUSES or (reads and route.endswith(_AUDITED_READS))):
        return
    caller: Principal | None = state.get(PRINCIPAL)
    services.audit.note(
        Entry(
            tenant="default" if caller is None else caller.tenant,
            actor="-" if caller is None else caller.key_id,
            address=(scope.get("client") or ("-",))[0],
            action=f"{method} {route}",
            target=" ".join(str(value) for value in scope.get("path_params", {}).values()),
            outcome=status,
            request_id=str(structlog.contextvars.get_contextvars().get("request_id", "")),
        )
    )


def page_policies(viewer: Path, docs: str) -> dict[str, str]:
    """The policies of the pages: the viewer at ``/``, the API's documentation at ``/docs``."""
    return {
        "/": page_policy((viewer / "index.html").read_text()),
        "/docs": page_policy(docs, style="'self' 'unsafe-inline'"),  # Swagger UI styles its elements in place
    }

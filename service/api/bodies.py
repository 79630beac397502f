"""Reading requests: limits of size, JSON without surprises, headers."""

from __future__ import annotations

from typing import Any, TypeVar

import orjson
from pydantic import BaseModel, ValidationError
from starlette.requests import Request
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from service.access.peers import BODY_SHA256, FORWARDED
from service.access.principal import LOCAL, Principal
from service.api.auth import PRINCIPAL
from service.api.digest import sha256
from service.api.problems import near, problem_response
from service.api.services import Services, services_of
from service.errors import (
    ConfigError,
    InputError,
    TooLargeError,
    UnauthorizedError,
    UnsupportedMediaTypeError,
)
from service.settings import MEBIBYTE, Settings

M = TypeVar("M", bound=BaseModel)
_JSON_LIMIT = "SKYPOSE_MAX_JSON_KB"


class BodyLimits:
    """ASGI middleware: counts the bytes of every request's body against its limit and the total."""

    def __init__(self, app: ASGIApp, settings: Settings) -> None:
        self._app = app
        self._settings = settings

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass on, with ``receive`` counted. A body declared too large is refused at once."""
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        error = self._refusal(scope)
        if error is not None:
            await problem_response(error)(scope, receive, send)
            return
        name, limit = self._limit(scope["path"])
        services = services_of(Request(scope))
        with services.admission.hold() as hold:

            async def counted() -> Message:
                message = await receive()
                size = len(message.get("body", b""))
                if size:
                    await _charge(services, scope, size, first=hold.size == 0, stored=name != _JSON_LIMIT)
                if hold.size + size > limit:
                    raise _too_large(name, limit)
                hold.tenant = _whose(scope)
                hold.grow(size)
                return message

            await self._app(scope, counted, send)

    def _refusal(self, scope: Scope) -> TooLargeError | None:
        declared = dict(scope["headers"]).get(b"content-length", b"0")
        name, limit = self._limit(scope["path"])
        if declared.isdigit() and int(declared) > limit:
            return _too_large(name, limit)
        return None

    def _limit(self, path: str) -> tuple[str, int]:
        settings = self._settings
        last = path.rstrip("/").rsplit("/", 1)[-1]
        if last == "checkpoint":
            return "SKYPOSE_MAX_CHECKPOINT_MB", settings.max_checkpoint_mb * MEBIBYTE
        if last == "models":
            return "SKYPOSE_MAX_MODEL_MB", settings.max_model_mb * MEBIBYTE
        if last == "background" or "/frames" in path:
            return "SKYPOSE_MAX_FRAME_MB", settings.max_frame_mb * MEBIBYTE
        return _JSON_LIMIT, settings.max_json_kb * 1024


async def _charge(services: Services, scope: Scope, size: int, *, first: bool, stored: bool) -> None:
    """Count bytes for the caller; whoever is in debt, or has no room, is refused at the first, not in the middle."""
    state = scope.get("state", {})
    caller: Principal | None = state.get(PRINCIPAL)
    if caller is not None and not state.get(FORWARDED):  # else they were counted where the call came in
        if first:
            services.limits.check(caller, "bytes")
            if stored:
                await services.stored.require_room(caller.tenant)
        services.limits.take(caller, "bytes", size)
        if stored:
            services.stored.grew(caller.tenant, size)


def _whose(scope: Scope) -> str:
    """The tenant that a body's bytes are counted for; none where no key is needed, as there is nobody else."""
    caller: Principal = scope.get("state", {}).get(PRINCIPAL, LOCAL)
    return "" if caller == LOCAL else caller.tenant


def _too_large(setting: str, limit: int) -> TooLargeError:
    return TooLargeError(f"the body is larger than {limit} bytes", field="body", limit=limit, setting=setting)


async def read_body(request: Request) -> tuple[bytes, str]:
    """The raw body and its SHA-256.

    Raises ``InputError`` for an empty one, ``UnauthorizedError`` for one that is not what the peer signed which hands
    the call on.
    """
    body = await request.body()
    if not body:
        raise InputError("the body is empty", field="body")
    found = await sha256(body)
    _require_signed(request, found)
    return body, found


def _require_signed(request: Request, found: str) -> None:
    if request.scope.get("state", {}).get(BODY_SHA256, found) != found:
        raise UnauthorizedError("no process of this cluster signed this body", field="body")


def media_type(request: Request) -> str:
    """The body's media type without parameters, in lower case; empty where none was given."""
    return request.headers.get("content-type", "").partition(";")[0].strip().lower()


async def read_json(request: Request, kind: type[M]) -> M:
    """A JSON body, strictly: no unknown fields, no NaN. Raises ``InputError`` that names the field."""
    if media_type(request) not in ("application/json", ""):
        raise UnsupportedMediaTypeError(
            "the body must be application/json", field="header:Content-Type", supported=["application/json"]
        )
    body = await request.body()
    if BODY_SHA256 in request.scope.get("state", {}):
        _require_signed(request, await sha256(body))
    try:
        data: Any = orjson.loads(body)
    except orjson.JSONDecodeError as error:
        raise InputError(f"the body is not JSON: {error}", field="body") from error
    try:
        return kind.model_validate(data, strict=True)
    except ValidationError as error:
        found = [
            {"field": ".".join(map(str, item["loc"])) or "body", "message": item["msg"] + near(item, n, kind)}
            for n, item in enumerate(error.errors(include_url=False, include_context=False, include_input=False))
        ]
        detail = f"{found[0]['field']}: {found[0]['message']}"
        raise ConfigError(detail, field=found[0]["field"], errors=found) from error


def idempotency_key(request: Request) -> str | None:
    """The Idempotency-Key header. Raises ``InputError`` for one that cannot be kept."""
    key = request.headers.get("idempotency-key")
    if key is None:
        return None
    if not 1 <= len(key) <= 255 or not key.isascii() or not key.isprintable():
        raise InputError("must be 1 to 255 printable ASCII characters", field="header:Idempotency-Key", limit=255)
    return key


def wants_async(request: Request) -> bool:
    """Whether the client sent ``Prefer: respond-async``."""
    wishes = ",".join(request.headers.getlist("prefer")).split(",")
    return any(wish.partition(";")[0].strip().lower() == "respond-async" for wish in wishes)

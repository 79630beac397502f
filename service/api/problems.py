"""Errors as RFC 9457 problem documents: the one place where they become HTTP."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from typing import Any

import orjson
import structlog
from fastapi import FastAPI, Request
from fastapi.exceptions import RequestValidationError
from fastapi.routing import APIRoute
from pydantic import BaseModel
from starlette.exceptions import HTTPException
from starlette.responses import Response

from service.errors import BusyError, InputError, SkyposeError, UnauthorizedError
from service.sessions.near import MOST, did_you_mean

log = structlog.get_logger(__name__)
MEDIA_TYPE = "application/problem+json"
NDJSON = "application/x-ndjson"
_PREFIX = "urn:skypose:problem:"
_LONGEST_DETAIL, _LONGEST_FIELD = 2000, 200  # characters


def problem_type(kind: type[SkyposeError]) -> str:
    """The stable ``type`` of an error."""
    return _PREFIX + kind.slug


def problem_document(error: SkyposeError) -> dict[str, Any]:
    """RFC 9457 of an error."""
    body: dict[str, Any] = {
        **error.facts,
        "type": problem_type(type(error)),
        "title": error.title,
        "status": error.status,
        "detail": _cut(error.detail, _LONGEST_DETAIL),
    }
    if error.field is not None:
        body["field"] = _cut(error.field, _LONGEST_FIELD)
    return body


def _cut(text: str, most: int) -> str:
    """What is told of a request repeats what stood in it, which may be megabytes."""
    return text if len(text) <= most else f"{text[:most]}..."


def problem_line(error: SkyposeError) -> bytes:
    """The last line of an answer of lines (``NDJSON``) that broke off."""
    return orjson.dumps(problem_document(error)) + b"\n"


def problem_response(error: SkyposeError) -> Response:
    """The answer to a call that raised ``error``."""
    headers = {}
    if isinstance(error, BusyError):
        headers["Retry-After"] = str(error.facts.get("retry_after_s", error.retry_after_s))
    if isinstance(error, UnauthorizedError):
        headers["WWW-Authenticate"] = 'Bearer realm="skypose"'
    return _response(error.status, problem_document(error), headers)


def install(app: FastAPI) -> None:
    """Answer every error of this application as a problem document."""
    app.add_exception_handler(SkyposeError, _on_skypose_error)
    app.add_exception_handler(RequestValidationError, _on_invalid_request)
    app.add_exception_handler(HTTPException, _on_http_exception)
    app.add_exception_handler(Exception, _on_unexpected)


async def _on_skypose_error(request: Request, error: Exception) -> Response:
    assert isinstance(error, SkyposeError)
    request.app.state.services.metrics.refusals.labels(error.slug).inc()
    if error.status >= 500 and not isinstance(error, BusyError):
        log.error("internal error", detail=error.detail)
    return problem_response(error)


async def _on_invalid_request(request: Request, error: Exception) -> Response:
    assert isinstance(error, RequestValidationError)
    queries = _queries(request)
    found = [
        {"field": _field(item["loc"]), "message": str(item["msg"]) + "".join(near(item, n, kind) for kind in queries)}
        for n, item in enumerate(error.errors())
    ]
    first = found[0]
    detail = f"{first['field']}: {first['message']}"
    return await _on_skypose_error(request, InputError(detail, field=first["field"], errors=found))


def near(item: Mapping[str, Any], number: int, kind: type[BaseModel]) -> str:
    """What to add to pydantic's fault ``number`` where ``kind`` has no such field: see ``did_you_mean``."""
    if item["type"] != "extra_forbidden" or number >= MOST:
        return ""
    *where, name = (str(part) for part in item["loc"] if part != "query")
    return did_you_mean(where, name, _schema(kind))


@cache
def _schema(kind: type[BaseModel]) -> dict[str, Any]:
    return kind.model_json_schema()


def _queries(request: Request) -> list[type[BaseModel]]:
    """The models of what a route takes after its `?`; none of one that takes plain parameters."""
    route = request.scope.get("route")
    found = [one.field_info.annotation for one in route.dependant.query_params] if isinstance(route, APIRoute) else []
    return [one for one in found if isinstance(one, type) and issubclass(one, BaseModel)]


async def _on_http_exception(request: Request, error: Exception) -> Response:
    assert isinstance(error, HTTPException)
    slug = {404: "not-found", 405: "method-not-allowed"}.get(error.status_code, "invalid-request")
    body = {
        "type": _PREFIX + slug,
        "title": str(error.detail),
        "status": error.status_code,
        "detail": f"{request.method} {request.url.path}: {error.detail}",
    }
    return _response(error.status_code, body, dict(error.headers or {}))


async def _on_unexpected(request: Request, error: Exception) -> Response:
    log.error("unexpected error", exc_info=error, path=request.url.path)
    return problem_response(SkyposeError("an unexpected error; the log has its trace"))


def _response(status: int, body: dict[str, Any], headers: dict[str, str]) -> Response:
    return Response(orjson.dumps(body), status_code=status, media_type=MEDIA_TYPE, headers=headers)


def _field(location: tuple[int | str, ...]) -> str:
    where, *rest = (str(part) for part in location)
    return ":".join((where, ".".join(rest))) if rest else where

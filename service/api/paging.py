"""What all routes share: pages, and the problems they document."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Annotated, Any

import orjson
from fastapi import Query
from pydantic import BaseModel, ConfigDict, Field
from starlette.responses import Response

from service.api.problems import MEDIA_TYPE
from service.errors import InputError
from service.settings import Settings


class PageQuery(BaseModel):
    """Which page of a list. A model and not plain parameters, so that a misspelt one is refused, not passed over."""

    model_config = ConfigDict(extra="forbid", use_attribute_docstrings=True)

    after: Annotated[int, Field(ge=0, le=2**53)] = 0
    """Cursor, from `next`"""
    limit: Annotated[int, Field(ge=1)] = 100


Page = Annotated[PageQuery, Query()]


def page_limit(limit: int, settings: Settings) -> int:
    """The size of a page. Raises ``InputError`` past the service's limit."""
    if limit > settings.max_page:
        raise InputError(
            f"a page holds at most {settings.max_page}",
            field="query:limit",
            limit=settings.max_page,
            setting="SKYPOSE_MAX_PAGE",
        )
    return limit


def next_page(path: str, cursor: int | None, limit: int, more: str = "") -> str | None:
    """Where the next page is, or None after the last; ``more``: rest of the query."""
    return None if cursor is None else f"{path}?after={cursor}&limit={limit}{more}"


def stored_page(
    name: str,
    documents: Iterable[bytes],
    damaged: Sequence[str],
    cursor: int | None,
    limit: int,
    path: str | None = None,
) -> Response:
    """A page of what ``/v1/{name}`` (or ``path``) lists, with the ids of what is damaged."""
    return _response(name, documents, damaged=damaged, next=next_page(path or f"/v1/{name}", cursor, limit))


def page_response(name: str, documents: Iterable[bytes], following: str | None) -> Response:
    """A page of documents that are JSON already: nothing is parsed or checked again in the event loop."""
    return _response(name, documents, next=following)


def _response(name: str, documents: Iterable[bytes], **more: Any) -> Response:
    body = b'{"%s":[%s],%s' % (name.encode(), b",".join(documents), orjson.dumps(more)[1:])
    return Response(body, media_type="application/json")


def problems(*statuses: int) -> dict[int | str, dict[str, Any]]:
    """The OpenAPI entry of the refusals a route can give, beside those that every route with a caller can."""
    entry = {
        "description": "Refused, nothing changed",
        "content": {MEDIA_TYPE: {"schema": {"$ref": "#/components/schemas/Problem"}}},
    }
    with_body = {408} if 413 in statuses else set()
    return dict.fromkeys(sorted({401, 403, 429, 503, *with_body, *statuses}), entry)

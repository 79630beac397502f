"""The API's OpenAPI document: what FastAPI gathers from the routes, and what holds for all of them."""

from __future__ import annotations

from typing import Any

from fastapi import FastAPI

from service.api.schemas import Problem
from service.sessions.frame import ANY_KIND

_BYTES = {"schema": {"type": "string", "format": "binary"}}
_BEARER = {"type": "http", "scheme": "bearer", "description": "API key or OIDC token; none is needed on loopback"}


def bytes_sent(description: str) -> dict[str, Any]:
    """A body of bytes, for ``openapi_extra``. One media type: of several, generators of clients take the first."""
    return {"requestBody": {"required": True, "description": description, "content": {ANY_KIND: _BYTES}}}


def bytes_answered(media_type: str) -> dict[int | str, dict[str, Any]]:
    """An answer of bytes, for ``responses``."""
    return {200: {"content": {media_type: _BYTES}}}


class DescribedApi(FastAPI):
    """FastAPI with the parts of its description that no route brings, operations named as their functions are."""

    def __init__(self, **options: Any) -> None:
        super().__init__(generate_unique_id_function=lambda route: route.name, **options)

    def openapi(self) -> dict[str, Any]:
        """The document, made once."""
        if self.openapi_schema is None:
            document = super().openapi()
            document["components"]["schemas"]["Problem"] = Problem.model_json_schema()
            document["components"]["securitySchemes"] = {"bearer": _BEARER}
            document["security"] = [{"bearer": []}, {}]
        return super().openapi()

"""The sections of a session's configuration, as clients send them."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Annotated, Any

from pydantic import Field, GetJsonSchemaHandler, TypeAdapter
from pydantic.json_schema import JsonSchemaValue
from pydantic_core import CoreSchema

from service.inference.params import SessionConfig


@dataclass(frozen=True)
class _Section:
    """Any subset of a section's fields; described when the OpenAPI document is asked for."""

    kind: Any

    def __get_pydantic_json_schema__(self, _: CoreSchema, handler: GetJsonSchemaHandler) -> JsonSchemaValue:
        schema = TypeAdapter(self.kind).json_schema()
        schema.pop("required", None)
        return schema


SECTIONS: dict[str, Any] = {
    item.name: (Annotated[dict[str, Any] | None, _Section(item.default_factory)], Field(default=None))
    for item in fields(SessionConfig)
}
"""Fields of a session's document, as ``pydantic.create_model`` takes them."""

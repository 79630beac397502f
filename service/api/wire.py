"""What the documents of the wire share."""

from __future__ import annotations

import ast
import inspect
from itertools import pairwise

from pydantic import BaseModel, ConfigDict, GetJsonSchemaHandler
from pydantic.json_schema import JsonSchemaValue
from pydantic_core import CoreSchema


class Described(BaseModel):
    """Fields are described by the docstrings under them, which are read when somebody asks for the OpenAPI document.

    With pydantic's ``use_attribute_docstrings`` every start would read them, a tenth of its time.
    """

    @classmethod
    def __get_pydantic_json_schema__(cls, core_schema: CoreSchema, handler: GetJsonSchemaHandler) -> JsonSchemaValue:
        schema = handler(core_schema)
        told: dict[str, str] = {}
        for kind in cls.__mro__:
            if issubclass(kind, Described):
                told = attribute_docstrings(kind) | told
        shown = handler.resolve_ref_schema(schema)["properties"]
        for name in told.keys() & cls.model_fields.keys():
            shown[cls.model_fields[name].alias or name].setdefault("description", told[name])
        return schema


class Wire(Described):
    """Base of the documents: unknown fields are refused."""

    model_config = ConfigDict(extra="forbid", allow_inf_nan=False)


class Orientation(Wire):
    """Unit quaternion, rotation body -> camera, w >= 0."""

    w: float
    x: float
    y: float
    z: float


def attribute_docstrings(kind: type) -> dict[str, str]:
    """Field -> the docstring under it; of the class itself, without its bases."""
    try:
        (written,) = ast.parse(inspect.getsource(kind)).body
    except OSError:  # made by a function: nothing is written
        return {}
    assert isinstance(written, ast.ClassDef)
    return {
        field.target.id: inspect.cleandoc(below.value.value)
        for field, below in pairwise(written.body)
        if isinstance(field, ast.AnnAssign)
        and isinstance(field.target, ast.Name)
        and isinstance(below, ast.Expr)
        and isinstance(below.value, ast.Constant)
        and isinstance(below.value.value, str)
    }

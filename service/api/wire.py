"""What the documents of the wire share."""

from __future__ import annotations

from pydantic import BaseModel, ConfigDict


class Wire(BaseModel):
    """Base of the documents: unknown fields are refused."""

    model_config = ConfigDict(extra="forbid", use_attribute_docstrings=True, allow_inf_nan=False)


class Orientation(Wire):
    """Unit quaternion, rotation body -> camera, w >= 0."""

    w: float
    x: float
    y: float
    z: float

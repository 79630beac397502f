"""How the values of a configuration are checked, where it is defined."""

from __future__ import annotations

from typing import Any

FORBID: dict[str, Any] = {"extra": "forbid", "use_attribute_docstrings": True, "allow_inf_nan": False}
"""For pydantic: of every section."""


class FieldError(ValueError):
    """A value that its own field is to be named for; others are told by their section."""

    def __init__(self, field: str, message: str) -> None:
        super().__init__(f"{field} {message}")
        self.field, self.fault = field, message


def require(ok: bool, message: str) -> None:
    """Raises ``ValueError`` unless ``ok``."""
    if not ok:
        raise ValueError(message)

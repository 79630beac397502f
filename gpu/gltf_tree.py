"""Parts of a glTF file's JSON, which may be anything."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, TypeGuard


def entries(tree: Mapping[str, Any], key: str) -> Sequence[Mapping[str, Any]]:
    """The objects of a list; none where there is no list."""
    found = tree.get(key, [])
    return [entry for entry in found if isinstance(entry, dict)] if isinstance(found, list) else []


def is_index(value: Any, items: Sequence[Any]) -> TypeGuard[int]:
    """Whether a value is the number of one of these."""
    return isinstance(value, int) and 0 <= value < len(items)

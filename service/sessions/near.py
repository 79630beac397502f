"""For a name that there is not, in what a client sent: the one that was meant."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from difflib import get_close_matches
from typing import Any

MOST = 20
"""Faults of one request that are looked at: the comparison takes a fraction of a millisecond each."""
_LONGEST = 64  # characters
_ALIKE_ELSEWHERE = 0.8  # of difflib's ratio: a name of another section has to be nearer than one of the same


def did_you_mean(where: Sequence[str], name: str, schema: Mapping[str, Any]) -> str:
    """``; did you mean ...?``, or nothing. ``where``: the fields around ``name``; ``schema``: JSON Schema of the whole.

    One that is right elsewhere goes before one that is nearly right here.
    """
    if len(name) > _LONGEST:
        return ""
    here = tuple(where)
    known = list(_paths(schema, schema.get("$defs", {})))
    elsewhere = {path[-1]: path for path in reversed(known) if path[:-1] != here}
    near = get_close_matches(name, [path[-1] for path in known if path[:-1] == here], 1)
    if name not in elsewhere and near:
        return f"; did you mean `{near[0]}`?"
    for other in get_close_matches(name, elsewhere, 1, _ALIKE_ELSEWHERE):
        path = elsewhere[other]
        beside = f" beside `{'.'.join(here)}`" if len(path) == 1 else ""
        return f"; did you mean `{'.'.join(path)}`{beside}?"
    return ""


def _paths(schema: Mapping[str, Any], shared: Mapping[str, Any], *above: str) -> Iterator[tuple[str, ...]]:
    """Each field and those below it; a field is below itself in none of ours."""
    reference = schema.get("$ref", "").rpartition("/")[2]
    for one in (*([shared[reference]] if reference in shared else []), *schema.get("anyOf", ())):
        yield from _paths(one, shared, *above)
    for name, field in schema.get("properties", {}).items():
        yield (*above, name)
        yield from _paths(field, shared, *above, name)

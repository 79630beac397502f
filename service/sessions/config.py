"""From what a client sends to the effective configuration of its session."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from typing import Any

import orjson
from pydantic import TypeAdapter, ValidationError
from pydantic_core import ErrorDetails

from service.errors import ConfigError
from service.inference.articulation import Articulation
from service.inference.params import SessionConfig, preset_defaults
from service.sessions.near import MOST, did_you_mean

RETIRED: Mapping[str, tuple[str, ...]] = {
    "filter": (
        *("acquisition_moves", "acquisition_particles", "adaptive", "enough_ess", "least_particles", "moves"),
        *("prefer", "target_ess"),
    ),
    "likelihood": (
        *("covered_empty_nats", "edge_nats_per_px", "exponent", "kind", "misfit_nats", "mode_exponent"),
        *("shading_nats", "shading_power", "uncovered_bright_nats"),
    ),
}
"""Of the outline's filter (methods `tempered` and `importance`), which `mixture` took the place of."""
_RETIRED_METHODS = ("tempered", "importance")
CONFIG: TypeAdapter[SessionConfig] = TypeAdapter(SessionConfig)


def effective(sections: Mapping[str, Any]) -> SessionConfig:
    """Lay what was sent over the preset's defaults, and check the whole.

    Raises ``ConfigError`` that names every unknown field and every value outside its limits.
    """
    merged: dict[str, Any] = {name: dict(values) for name, values in _preset(sections).items()}
    for name, given in sections.items():
        if not isinstance(given, Mapping):
            raise ConfigError(f"{name} must be an object", field=name)
        merged[name] = {**merged.get(name, {}), **given}
    return parse(orjson.dumps(merged))


def parse(document: bytes) -> SessionConfig:
    """A configuration from JSON. Raises ``ConfigError``."""
    try:
        return CONFIG.validate_json(document, strict=True)
    except ValidationError as error:
        raise _config_error(error) from error


def stored(document: Mapping[str, Any]) -> SessionConfig:
    """The configuration of a session that may have been stored by an earlier version: what is no more is left out.

    Raises ``ConfigError``.
    """
    return parse(orjson.dumps(without_retired(document)[0]))


def without_retired(sections: Mapping[str, Any]) -> tuple[dict[str, Any], tuple[str, ...]]:
    """Sections as an earlier version took them, less what is no more; and a sentence on each thing left out."""
    left: dict[str, Any] = dict(sections)
    said: list[str] = []
    for name, retired in RETIRED.items():
        if isinstance(left.get(name), Mapping):
            gone = [key for key in retired if key in left[name]]
            left[name] = {key: value for key, value in left[name].items() if key not in retired}
            said += [f"{name}.{key} is no more, and was left out" for key in gone]
    chosen = left.get("filter")
    if isinstance(chosen, Mapping) and chosen.get("method") in _RETIRED_METHODS:
        said.append(f"filter.method {chosen['method']} is no more: auto")
        left["filter"] = {**chosen, "method": "auto"}
    return left, tuple(said)


def unused(sections: Mapping[str, Any], config: SessionConfig) -> tuple[str, ...]:
    """A sentence on each thing that was chosen for the other method."""
    if config.filter.method == "bootstrap":
        told = {
            "joints.sun_tracking": bool(config.joints.sun_tracking),
            "prior.attitude_mode": config.prior.attitude_mode is not None,
        }
        return tuple(f"{name} is not for bootstrap, and is not used" for name, given in told.items() if given)
    chosen = [name for name in ("backend", "resampler", "step") if name in sections.get("filter", {})]
    return tuple(f"filter.{name} is for bootstrap, and is not used" for name in chosen)


def document(config: SessionConfig) -> dict[str, Any]:
    """The configuration as JSON data; ``parse`` reads it back."""
    data: dict[str, Any] = CONFIG.dump_python(config, mode="json")
    return data


def check_joints(config: SessionConfig, articulation: Articulation) -> tuple[str, ...]:
    """Hold the session's joints against the model's. Returns warnings; raises ``ConfigError``."""
    known = {joint.name: joint for joint in articulation.joints}
    every = set(known) - set(config.joints.fixed)
    free = every if config.joints.free == "all" else set(config.joints.free)
    for name in (*sorted(free), *config.joints.fixed):
        if name not in known:
            raise ConfigError(f"the model has no joint {name!r}", field="joints", known=list(known))
    for name, value in config.joints.fixed.items():
        if name in free:
            raise ConfigError(f"joint {name!r} cannot be free and fixed", field=f"joints.fixed.{name}")
        joint = known[name]
        if not joint.minimum <= value <= joint.maximum:
            raise ConfigError(
                f"joint {name!r} reaches from {joint.minimum:g} to {joint.maximum:g}",
                field=f"joints.fixed.{name}",
                minimum=joint.minimum,
                maximum=joint.maximum,
            )
    for name in config.joints.sun_tracking:
        if name not in free:
            raise ConfigError(f"{name!r} is no free joint that could track the Sun", field="joints.sun_tracking")
        if known[name].kind != "revolute":
            raise ConfigError(f"joint {name!r} slides: it cannot track the Sun", field="joints.sun_tracking")
    resting = [name for name in known if name not in free and name not in config.joints.fixed]
    if not resting:
        return ()
    return (f"not estimated, held at their initial value: {', '.join(resting)}",)


def _preset(sections: Mapping[str, Any]) -> Mapping[str, Mapping[str, Any]]:
    chosen = sections.get("filter", {})
    preset = chosen.get("preset", "balanced") if isinstance(chosen, Mapping) else "balanced"
    try:
        return preset_defaults(preset)
    except ValueError:
        return {}  # the check of the whole says which presets there are


def _config_error(error: ValidationError) -> ConfigError:
    found = [
        {"field": _field(item), "message": _message(item) + (_near(item) if n < MOST else "")}
        for n, item in enumerate(error.errors(include_url=False, include_input=False))
    ]
    first = found[0]["field"]
    said = dict.fromkeys(item["message"] for item in found if item["field"] == first)  # one for each type it may have
    detail = "; or: ".join(said)
    if not first:  # of sections that do not go together: the sentence names them
        return ConfigError(detail, errors=found)
    return ConfigError(f"{first}: {detail}", field=first, errors=found)


def _message(item: ErrorDetails) -> str:
    """Of a check of ours what it says, without the kind that pydantic puts before it and the field, told beside it."""
    ours = item.get("ctx", {}).get("error")
    return str(getattr(ours, "fault", ours)) if isinstance(ours, ValueError) else item["msg"]


def _near(item: ErrorDetails) -> str:
    if item["type"] not in ("unexpected_keyword_argument", "extra_forbidden"):
        return ""
    *path, name = (str(part) for part in item["loc"])
    return did_you_mean(path, name, _schema())


@cache
def _schema() -> dict[str, Any]:
    return CONFIG.json_schema()


def _field(item: ErrorDetails) -> str:
    """Dotted name of what an error is about: without the types it may have, with the field that the error names."""
    parts = [str(part) for part in item["loc"]]
    types = [n for n, part in enumerate(parts) if part.startswith(("literal[", "tuple["))]
    named = getattr(item.get("ctx", {}).get("error"), "field", None)
    return ".".join([*parts[: types[0] if types else None], *([named] if named else [])])

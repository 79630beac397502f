"""Every choice a session can make, as data that is stored with it. One definition serves filter, API and docs."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, ClassVar, Literal

_FORBID: dict[str, Any] = {"extra": "forbid", "use_attribute_docstrings": True, "allow_inf_nan": False}


def _require(ok: bool, message: str) -> None:
    if not ok:
        raise ValueError(message)


@dataclass(frozen=True)
class FilterParams:
    """The particle filter itself."""

    __pydantic_config__: ClassVar[dict[str, Any]] = _FORBID

    preset: Literal["balanced", "paper"] = "balanced"
    """Where every other default comes from. ``paper`` is the published method, nothing else."""
    particles: int = 1000
    """Particles carried from frame to frame."""
    seed: int = 0
    """Same seed and same frames, same estimates."""

    def __post_init__(self) -> None:
        _require(1 <= self.particles <= 10_000_000, "particles must be between 1 and 10,000,000")


@dataclass(frozen=True)
class SessionConfig:
    """The effective configuration of a session."""

    __pydantic_config__: ClassVar[dict[str, Any]] = _FORBID

    filter: FilterParams = field(default_factory=FilterParams)


def preset_defaults(preset: str) -> Mapping[str, Any]:
    """Nested plain defaults of a preset, to be overlaid by what a client sends."""
    raise NotImplementedError(preset)

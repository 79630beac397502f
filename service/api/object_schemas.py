"""Objects, on the wire: what several sessions are of (docs/objects.md)."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field

from service.api.motion import PassMotion, Vector
from service.api.wire import Wire


class ObjectRequest(Wire):
    """A new object."""

    name: str = Field(min_length=1, max_length=200)
    sessions: list[str] = Field(default_factory=list, max_length=1000)
    """That are of it already."""


class TrackedObject(Wire):
    """What several sessions are of: those of several telescopes, of several passes."""

    object_id: str
    name: str
    created_at: str
    sessions: list[str]
    """In order of their creation."""


class PassQuery(BaseModel):
    """Which pass of an object."""

    model_config = ConfigDict(extra="forbid", use_attribute_docstrings=True)

    number: Annotated[int, Field(ge=0, le=10**6)] | None = Field(None, alias="pass")
    """The last by default"""


class TrackedObjectList(Wire):
    """A page of objects."""

    objects: list[TrackedObject]
    damaged: list[str]
    next: str | None


class ObjectPass(Wire):
    """When an object was seen without a gap of half an hour, and by whom."""

    number: int = Field(alias="pass")
    """From 0, in order of time."""
    start: str
    end: str
    sessions: list[str]
    """In order of time."""


class ObjectPasses(Wire):
    """All passes of an object."""

    object_id: str
    passes: list[ObjectPass]


class SpinPass(Wire):
    """One pass of an object's spin."""

    number: int = Field(alias="pass")
    epoch: str
    model: Literal["constant_rate", "tumbling"]
    rate_deg_s: float
    rate_sigma_deg_s: float
    period_s: float
    period_sigma_s: float
    axis_gcrf: Vector
    turns_since_last: float | None
    """With their fraction; null where their number cannot be told."""
    turns_since_last_sigma: float | None
    """Of what was expected from all that was known: counted where it is below a sixth."""
    swing_since_last_deg: float | None
    """What no turn about the axis explains."""


class SpinLeftOut(Wire):
    """A pass that tells nothing of the spin."""

    number: int = Field(alias="pass")
    reason: str


class ObjectSpin(Wire):
    """How an object spins over its passes; sigmas are standard deviations. See docs/objects.md."""

    object_id: str
    epoch: str
    """The middle of the passes: of it rate and period are told."""
    rate_deg_s: float
    rate_sigma_deg_s: float
    period_s: float
    period_sigma_s: float
    period_change_s_per_day: float
    period_change_sigma_s_per_day: float
    axis_gcrf: Vector
    axis_gcrf_sigma_deg: float
    scale: float
    """By which stated spreads had to be multiplied; 1 where they hold."""
    passes: list[SpinPass]
    left_out: list[SpinLeftOut]
    warnings: list[str]


class ObjectMotion(PassMotion):
    """How an object turned over a pass, by all telescopes that saw it; `session_id` is that of the first of them."""

    object_id: str
    sessions: list[str]
    """Of this pass, in order of time."""
    number: int = Field(alias="pass")
    """From 0, in order of time."""
    passes: int
    """So many there are."""

"""Whether a checkpoint is one: everything in it comes from outside, and all of it will be believed later.

Every function raises ``ValueError`` (pydantic's among them) that says what does not fit.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from datetime import datetime
from typing import Annotated, Any, Literal, NotRequired

import numpy as np
import orjson
from pydantic import AfterValidator, ConfigDict, Field, TypeAdapter
from typing_extensions import TypedDict

from service.errors import CheckpointError
from service.sessions.document import JointNames
from service.sessions.frame import EARLIEST, LATEST
from service.store.base import SessionRecord
from service.workers.base import RestoreReport

EstimateCheck = Callable[[Mapping[str, Any]], object]
"""Raises ``ValueError`` for a document that is not what the API answers."""


def _moment(text: str) -> str:
    moment = datetime.fromisoformat(text)
    if moment.tzinfo is None or not EARLIEST <= moment <= LATEST:
        raise ValueError("a time is in UTC, and of this age")
    return text


Count = Annotated[int, Field(ge=0, le=2**53)]
Finite = Annotated[float, Field(ge=-1e12, le=1e12)]
Text = Annotated[str, Field(max_length=1 << 16)]
Digest = Annotated[str, Field(pattern="^[0-9a-f]{64}$")]
Key = Annotated[str, Field(max_length=300)] | None
Moment = Annotated[str, AfterValidator(_moment)]
_EXACTLY = ConfigDict(extra="forbid", strict=True)


class BackgroundRow(TypedDict):
    """A background image that was taken in."""

    __pydantic_config__ = _EXACTLY  # type: ignore[misc]

    session_id: NotRequired[Text]  # of older releases; the new one counts
    ordinal: Count
    sha256: Digest
    idempotency_key: Key
    frames: Count
    created_at: Moment


class FrameRow(TypedDict):
    """A frame that was tracked."""

    __pydantic_config__ = _EXACTLY  # type: ignore[misc]

    session_id: NotRequired[Text]  # of older releases; the new one counts
    idx: Count
    sha256: Digest
    idempotency_key: Key
    media_type: Text
    time: Moment
    time_s: Finite
    query: dict[str, str | Finite | bool | None]
    created_at: Moment
    epoch: Count


class EventRow(TypedDict):
    """An entry of the event log."""

    __pydantic_config__ = _EXACTLY  # type: ignore[misc]

    session_id: NotRequired[Text]  # of older releases; the new one counts
    seq: Count
    kind: Text
    idx: Count


class EstimateRow(TypedDict):
    """An estimate; its document is checked apart."""

    __pydantic_config__ = _EXACTLY  # type: ignore[misc]

    session_id: NotRequired[Text]  # of older releases; the new one counts
    idx: Count
    document: dict[str, Any]


class History(TypedDict):
    """What was answered so far."""

    __pydantic_config__ = _EXACTLY  # type: ignore[misc]

    backgrounds: list[BackgroundRow]
    frames: list[FrameRow]
    estimates: list[EstimateRow]
    events: list[EventRow]


class Info(TypedDict):
    """Size and depth of the background."""

    __pydantic_config__ = _EXACTLY  # type: ignore[misc]

    width: Count
    height: Count
    channels: Literal[1, 3]
    bits: Literal[8, 16]
    source: NotRequired[Literal["auto"]]


class Header(TypedDict):
    """The session's own row, as far as a checkpoint carries it."""

    __pydantic_config__ = _EXACTLY  # type: ignore[misc]

    name: Annotated[str, Field(max_length=1000)] | None
    config: dict[str, Any]
    warnings: list[Text]
    created_at: Moment
    updated_at: Moment
    next_index: Count
    next_seq: Count
    status: Literal["acquiring", "tracking", "ambiguous", "no_fit", "lost", "no_target"] | None
    time_s: Finite | None
    time_given: Moment | None
    background_key: Digest | None
    background_frames: Count
    background_info: Info | None


_HISTORY: TypeAdapter[History] = TypeAdapter(History)
_HEADER: TypeAdapter[Header] = TypeAdapter(Header)


def read_header(data: bytes) -> dict[str, Any]:
    """The session's own fields. ``model_id``, which older releases wrote, is left out."""
    given = orjson.loads(data)
    if isinstance(given, dict):
        given.pop("model_id", None)
    return dict(_HEADER.validate_python(given))


def read_history(data: bytes) -> History:
    """Frames, estimates, events and backgrounds, in their own order."""
    history = _HISTORY.validate_python(orjson.loads(data))
    for rows in (history["backgrounds"], history["frames"]):
        keys = [row["idempotency_key"] for row in rows if row["idempotency_key"] is not None]
        if len(set(keys)) != len(keys):
            raise ValueError("an idempotency key is there twice")
    ordinals = [row["ordinal"] for row in history["backgrounds"]]
    if ordinals != sorted(set(ordinals)):
        raise ValueError("the backgrounds are in no order")
    return history


def check_history(record: SessionRecord, history: History) -> None:
    """The history is without gaps and ends where the session stands."""
    indexes = list(range(record.next_index))
    for rows in (history["frames"], history["estimates"], history["events"]):
        if [row["idx"] for row in rows] != indexes:
            raise ValueError("the history has gaps")
    if record.next_seq != record.next_index + 1 or [row["seq"] for row in history["events"]] != [
        n + 1 for n in indexes
    ]:
        raise ValueError("the event log has gaps")
    last = (history["frames"][-1]["time_s"], history["estimates"][-1]["document"].get("status")) if indexes else None
    if (record.time_s, record.status) != (last or (None, None)):
        raise ValueError("the session's time or status is not that of its last frame")


def check_estimates(history: History, names: Mapping[str, JointNames], check: EstimateCheck) -> None:
    """Every estimate is one that this service could have given. ``names``: by model."""
    for row in history["estimates"]:
        document = row["document"]
        check(document)
        _moment(document["time"])
        if document["index"] != row["idx"]:
            raise ValueError("an estimate is not that of its frame")
        free = names[_model_of(document, names)].free
        size = 6 + len(free)
        for pose in (document["mean"], document["best"], *(mode["pose"] for mode in document["modes"])):
            if not set(free) <= set(pose["joints"]):
                raise ValueError("an estimate lacks a joint")
        if np.shape(document["spread"]["covariance"]) != (size, size):
            raise ValueError(f"a covariance is not {size} x {size}")


def _model_of(document: Mapping[str, Any], names: Mapping[str, JointNames]) -> str:
    """The model that an estimate was made with; in a session that compares models, the first that it ranks."""
    ranked = [entry["model_id"] for entry in document.get("models") or ()]
    if sorted(ranked) != (sorted(names) if len(names) > 1 else []):
        raise ValueError("an estimate ranks other models than those of the session")
    return str(ranked[0]) if ranked else next(iter(names))


def require_restored(record: SessionRecord, found: RestoreReport, *, leads: bool = True) -> None:
    """Raises ``CheckpointError`` where background or particles are not those that the session describes.

    ``leads``: the particles are those that the session shows, and not of a model that it holds for less probable.
    """
    info = record.background_info or {}
    if (found.background_frames, found.channels, found.bits) != (
        record.background_frames,
        info.get("channels"),
        info.get("bits"),
    ):
        raise CheckpointError("the background is not as the session describes it", field="body")
    status = record.status if leads else found.status
    if record.next_index and (found.frame_index, found.time_s, found.status) != (
        record.next_index - 1,
        record.time_s,
        status,
    ):
        raise CheckpointError("the particles are not those of the last frame", field="body")

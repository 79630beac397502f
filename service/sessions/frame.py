"""A frame on its way in, its answer, and the arithmetic of its time."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from datetime import UTC, datetime, timedelta
from itertools import islice
from typing import Any, TypeVar

from service.errors import ConflictError, FrameConflictError, FrameGapError, IdempotencyKeyError, InputError
from service.imaging.facts import FrameFacts
from service.imaging.headers import sniffed
from service.inference.params import SessionConfig
from service.store.base import SessionRecord, StoredFrame

EARLIEST, LATEST = datetime(1800, 1, 1, tzinfo=UTC), datetime(2200, 1, 1, tzinfo=UTC)  # else it is a slip of the pen
T = TypeVar("T")
ANY_KIND = "application/octet-stream"  # what generated clients send
OWN_SKY_FRAMES = (0, 1, 2, 4, 8)
"""From which a session without empty frames learns its sky."""


@dataclass(frozen=True)
class FrameIn:
    """One image as it was posted."""

    body: bytes
    sha256: str
    media_type: str
    received: datetime
    index: int | None = None  # chosen by the client (PUT), or None: the next
    idempotency_key: str | None = None
    time: datetime | None = None
    query: Mapping[str, Any] = field(default_factory=dict)
    facts: FrameFacts | None = None  # of a frame out of a larger file; None: the body says what there is to say


@dataclass(frozen=True)
class BackgroundIn:
    """One background image (or multi-frame file) as it was posted."""

    body: bytes
    sha256: str
    media_type: str
    idempotency_key: str | None = None
    box: tuple[float, float, float, float] | None = None
    border_px: float | None = None


@dataclass(frozen=True)
class Answer:
    """An estimate as JSON bytes."""

    index: int
    document: bytes
    duplicate: bool


@dataclass(frozen=True)
class BackgroundAnswer:
    """What a background call says."""

    background_frames: int
    state: str = "ready"


@dataclass(frozen=True)
class FrameTime:
    """When a frame was taken: for people (UTC), and for the filter (seconds since the first frame)."""

    utc: datetime
    given: datetime | None
    seconds: float


def kind_of(media_type: str, body: bytes) -> str:
    """The media type as given; of ``ANY_KIND`` what the body begins as, where that is known."""
    return sniffed(body) or media_type if media_type == ANY_KIND else media_type


def frame_time(record: SessionRecord, frame: FrameIn, interval_s: float, before: datetime | None) -> FrameTime:
    """The frame's time. Raises ``InputError`` for one before the previous frame's.

    ``before``: when the previous frame was taken (UTC); a frame that brings no time follows it after the interval.

    The filter's clock must not depend on when a frame happened to arrive, or a repeated pass would differ: it
    counts the given times, and the nominal interval where there are none.
    """
    if frame.time is not None and not EARLIEST <= frame.time <= LATEST:
        raise InputError(
            f"a frame is of {EARLIEST.year} to {LATEST.year}",
            field="time",
            minimum=str(EARLIEST),
            maximum=str(LATEST),
        )
    previous = None if record.time_given is None else datetime.fromisoformat(record.time_given)
    if frame.time is not None and previous is not None and frame.time < previous:
        raise InputError("the frame is older than the one before", field="time", previous=format_time(previous))
    if record.time_s is None:
        seconds = 0.0
    elif frame.time is not None and previous is not None:
        seconds = record.time_s + (frame.time - previous).total_seconds()
    else:
        seconds = record.time_s + interval_s
    following = frame.received if before is None else before + timedelta(seconds=interval_s)
    return FrameTime(frame.time or following, frame.time, seconds)


def format_time(moment: datetime) -> str:
    """UTC, ISO 8601 with Z; milliseconds unless there is more."""
    moment = moment.astimezone(UTC)
    digits = "microseconds" if moment.microsecond % 1000 else "milliseconds"
    return moment.isoformat(timespec=digits).removesuffix("+00:00") + "Z"


def repeated(
    frame: FrameIn, next_index: int, at_index: StoredFrame | None, under_key: StoredFrame | None
) -> int | None:
    """Index of the stored frame that this one repeats, or None for a new one.

    Raises ``IdempotencyKeyError``, ``FrameConflictError`` or ``FrameGapError``.
    """
    if under_key is not None:
        if under_key.sha256 != frame.sha256 or frame.index not in (None, under_key.index):
            raise IdempotencyKeyError(
                f"the key was used for frame {under_key.index} with other content",
                field="header:Idempotency-Key",
                index=under_key.index,
            )
        return under_key.index
    if at_index is not None:
        if at_index.sha256 != frame.sha256:
            raise FrameConflictError(f"frame {at_index.index} holds other bytes", field="index", sha256=at_index.sha256)
        return at_index.index
    if frame.index is not None and frame.index != next_index:
        raise FrameGapError(
            f"frame {frame.index} is not the next; frame {next_index} is", field="index", expected=next_index
        )
    return None


def learns_own_sky(config: SessionConfig, record: SessionRecord) -> bool:
    """Whether this frame is one of those from which a session without empty frames learns its sky.

    Fewer and fewer, since the object has moved little from one to the next. What was posted goes before.
    """
    if config.camera.background != "auto" or record.next_index not in OWN_SKY_FRAMES:
        return False
    if record.background_key is not None and not is_own_sky(record):
        return False
    return record.background_frames == OWN_SKY_FRAMES.index(record.next_index)


def own_sky_frames(frames: Iterable[T]) -> list[T]:
    """Those of a whole pass; no later one is looked at."""
    return [one for k, one in enumerate(islice(frames, OWN_SKY_FRAMES[-1] + 1)) if k in OWN_SKY_FRAMES]


def require_going_on(record: SessionRecord) -> None:
    """Raises ``ConflictError`` for a session that has ended."""
    if record.ended_at is not None:
        raise ConflictError(
            f"the session ended at {record.ended_at}, unused for long; begin another",
            ended_at=record.ended_at,
            setting="SKYPOSE_END_IDLE_DAYS",
        )


def is_own_sky(record: SessionRecord) -> bool:
    """Whether the sky was learned from frames that show the object."""
    return (record.background_info or {}).get("source") == "auto"


def assumed_of(record: SessionRecord, frame: FrameIn, *, held: bool) -> list[str]:
    """What the images do not show and was taken for granted: see ``schemas.Estimate.assumed``."""
    return [
        *(["background"] if is_own_sky(record) else []),
        *(["time"] if frame.time is None else []),
        *(["attitude_mode"] if held else []),
    ]


def known_background(image: BackgroundIn, sha256: str, frame_count: int) -> BackgroundAnswer:
    """The answer to a background that was taken before. Raises ``IdempotencyKeyError`` for other content."""
    if sha256 != image.sha256:
        raise IdempotencyKeyError(
            "the key was used for a background with other content", field="header:Idempotency-Key"
        )
    return BackgroundAnswer(frame_count)

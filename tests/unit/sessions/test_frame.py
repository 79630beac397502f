"""A frame's time, and how a repeated frame is told from a new one."""

from dataclasses import replace
from datetime import UTC, datetime, timedelta

import pytest

from service.errors import FrameConflictError, FrameGapError, IdempotencyKeyError, InputError
from service.sessions.frame import FrameIn, format_time, frame_time, repeated
from service.store.base import SessionRecord, StoredFrame

T0 = datetime(2026, 11, 20, 3, 4, 5, 678000, UTC)
RECORD = SessionRecord("s", "m", None, {}, (), "t", "t")
FRAME = FrameIn(b"", "hash", "image/png", received=T0)


@pytest.mark.parametrize(
    ("microsecond", "text"), [(678000, "2026-11-20T03:04:05.678Z"), (678901, "2026-11-20T03:04:05.678901Z")]
)
def test_times_are_utc_with_z(microsecond, text):
    assert format_time(T0.replace(microsecond=microsecond)) == text


def test_clock_counts_given_times_and_nominal_intervals():
    first = frame_time(RECORD, replace(FRAME, time=T0), 0.1, None)
    assert (first.seconds, first.utc) == (0.0, T0)
    after = replace(RECORD, time_s=5.0, time_given=T0.isoformat())
    assert frame_time(after, replace(FRAME, time=T0 + timedelta(seconds=2.5)), 0.1, T0).seconds == 7.5
    assert frame_time(after, FRAME, 0.1, T0).seconds == 5.1
    without = replace(RECORD, time_s=5.0)
    assert frame_time(without, replace(FRAME, time=T0), 0.1, T0).seconds == 5.1
    with pytest.raises(InputError):
        frame_time(after, replace(FRAME, time=T0 - timedelta(microseconds=1)), 0.1, T0)


def test_a_frame_without_a_time_follows_the_one_before():
    assert frame_time(RECORD, FRAME, 0.1, None).utc == T0  # the first: when it came
    later = replace(FRAME, received=T0 + timedelta(seconds=60))
    assert frame_time(replace(RECORD, time_s=0.0), later, 0.1, T0).utc == T0 + timedelta(seconds=0.1)


@pytest.mark.parametrize("time", ["9999-12-31T23:59:59-23:59", "0001-01-01T00:00:00+23:59", "2300-01-01T00:00:00Z"])
def test_a_time_that_no_frame_can_have_is_refused(time):
    with pytest.raises(InputError, match="1800 to 2200"):
        frame_time(RECORD, replace(FRAME, time=datetime.fromisoformat(time)), 0.1, None)


STORED = StoredFrame(3, "hash", "key")


@pytest.mark.parametrize(
    ("frame", "at_index", "under_key", "outcome"),
    [
        (FRAME, None, None, None),
        (replace(FRAME, index=7), None, None, None),
        (replace(FRAME, index=8), None, None, FrameGapError),
        (replace(FRAME, index=3), STORED, None, 3),
        (replace(FRAME, index=3, sha256="other"), STORED, None, FrameConflictError),
        (FRAME, None, STORED, 3),
        (replace(FRAME, index=3), STORED, STORED, 3),
        (replace(FRAME, sha256="other"), None, STORED, IdempotencyKeyError),
        (replace(FRAME, index=4), None, STORED, IdempotencyKeyError),
    ],
)
def test_repeated_frames(frame, at_index, under_key, outcome):
    if isinstance(outcome, type):
        with pytest.raises(outcome):
            repeated(frame, 7, at_index, under_key)
    else:
        assert repeated(frame, 7, at_index, under_key) == outcome

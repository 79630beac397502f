"""Which sessions end and go, and when."""

from datetime import UTC, datetime

import pytest

from service.store.base import SessionStamp
from service.store.rules import Rules, unused

NOW = datetime(2026, 11, 23, tzinfo=UTC)
USED = "2026-11-13T00:00:00.000Z"


@pytest.mark.parametrize(
    ("rules", "ended_at", "due"),
    [
        (Rules(), None, None),
        (Rules(), "2001-01-01T00:00:00.000Z", None),
        (Rules(end_idle_days=9.9), None, "end"),
        (Rules(end_idle_days=10), None, None),
        (Rules(end_idle_days=1), NOW.isoformat(), None),
        (Rules(retain_ended_days=1), None, None),
        (Rules(retain_ended_days=1), "2026-11-21T23:59:59.999Z", "delete"),
        (Rules(retain_ended_days=1), "2026-11-22T00:00:00.000Z", None),
    ],
)
def test_rules(rules, ended_at, due):
    assert rules.due(SessionStamp("s", USED, ended_at), NOW) == due


def test_moments_are_utc_unless_they_say():
    assert unused("2026-11-22T00:59:00", 0.95, NOW)
    assert not unused("2026-11-22T00:59:00-01:00", 0.95, NOW)

"""When a session ends, and when it goes."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from typing import Literal

from service.store.base import SessionStamp


@dataclass(frozen=True)
class Rules:
    """Days; 0: never."""

    end_idle_days: float = 0.0
    retain_ended_days: float = 0.0

    def due(self, stamp: SessionStamp, now: datetime) -> Literal["end", "delete"] | None:
        """What is to be done with a session now."""
        if stamp.ended_at is None:
            return "end" if self.end_idle_days and unused(stamp.updated_at, self.end_idle_days, now) else None
        return "delete" if self.retain_ended_days and unused(stamp.ended_at, self.retain_ended_days, now) else None


def unused(since: str, days: float, now: datetime) -> bool:
    """Whether a moment (ISO 8601, UTC where it does not say) is so many days ago."""
    moment = datetime.fromisoformat(since)
    return (moment if moment.tzinfo else moment.replace(tzinfo=UTC)) < now - timedelta(days=days)

"""How many frames may wait: of one session, of all together, and of a tenant where all together are too many.

Whoever is let in later would wait for all of them.
"""

from __future__ import annotations

from collections import Counter

from service.errors import BusyError, InboxFullError


class Line:
    """Counts the calls that wait or are under way in all sessions."""

    def __init__(self, of_session: int, of_all: int) -> None:
        self._of_session = of_session
        self._of_all = of_all
        self._held: Counter[str] = Counter()  # by tenants that have any

    def require_room(self, tenant: str, waiting: int) -> None:
        """Raise ``InboxFullError`` for a session with too many ``waiting``, ``BusyError`` where all together are.

        When the line is full, a tenant with less than an even share of it still finds room: what one tenant piles up
        does not shut out another.
        """
        if waiting >= self._of_session:
            raise InboxFullError(
                f"{self._of_session} frames of this session are waiting",
                limit=self._of_session,
                setting="SKYPOSE_SESSION_INBOX_FRAMES",
            )
        share = self._of_all // len({*self._held, tenant})
        if self._held.total() >= self._of_all and self._held[tenant] >= share:
            raise BusyError(
                f"{self._of_all} frames are waiting or under way",
                limit=self._of_all,
                setting="SKYPOSE_MAX_WAITING_FRAMES",
            )

    def enter(self, tenant: str) -> None:
        """One more."""
        self._held[tenant] += 1

    def leave(self, tenant: str) -> None:
        """One less."""
        self._held[tenant] -= 1
        if not self._held[tenant]:
            del self._held[tenant]

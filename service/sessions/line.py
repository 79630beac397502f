"""How many frames may wait: of one session, and of all together. Whoever is let in later would wait for all of them."""

from __future__ import annotations

from service.errors import BusyError, InboxFullError


class Line:
    """Counts the calls that wait or are under way in all sessions."""

    def __init__(self, of_session: int, of_all: int) -> None:
        self._of_session = of_session
        self._of_all = of_all
        self.size = 0

    def require_room(self, waiting: int) -> None:
        """Raise ``InboxFullError`` for a session with too many ``waiting``, ``BusyError`` where all together are."""
        if waiting >= self._of_session:
            raise InboxFullError(
                f"{self._of_session} frames of this session are waiting",
                limit=self._of_session,
                setting="SKYPOSE_SESSION_INBOX_FRAMES",
            )
        if self.size >= self._of_all:
            raise BusyError(
                f"{self._of_all} frames are waiting or under way",
                limit=self._of_all,
                setting="SKYPOSE_MAX_WAITING_FRAMES",
            )

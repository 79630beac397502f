"""When a call may be sent again, and after which pause. No clock and no connection in here."""

from __future__ import annotations

import random
from collections.abc import Callable
from dataclasses import dataclass, field

import httpx

from service.remote.errors import RefusedError, refusal

_NOTHING_CHANGED = (429, 503)  # the service says so: any call may simply be sent again
_GATEWAY = (502, 504)  # a proxy lost the answer: as good as a broken connection


@dataclass(frozen=True)
class Retries:
    """How often and how patiently a client repeats a call that failed for the moment."""

    attempts: int = 8
    """Of one call, the first included. 1 never repeats."""
    first_pause_s: float = 0.2
    """Doubles with every attempt; half of it is drawn at random, so that many clients do not come back at once."""
    longest_pause_s: float = 30.0
    """Also the most that a Retry-After is followed."""
    random: Callable[[], float] = field(default=random.random, repr=False)
    """Uniform numbers in [0, 1)."""

    def pause_s(self, failures: int, asked_s: float | None) -> float:
        """Pause after so many failures in a row; at least what the service asked for."""
        grown = self.first_pause_s * 2.0 ** (failures - 1) * (0.5 + 0.5 * self.random())
        return min(max(grown, asked_s or 0.0), self.longest_pause_s)


class Attempts:
    """The attempts of one call. ``repeatable``: sending it twice does no harm, whatever became of the first."""

    def __init__(self, retries: Retries, *, repeatable: bool) -> None:
        self._retries = retries
        self._repeatable = repeatable
        self.failures = 0

    def succeeded(self) -> None:
        """Something came: of a stream that breaks later, the count begins anew."""
        self.failures = 0

    def after_break(self, error: Exception) -> float:
        """Pause in seconds after a broken connection. Raises ``error`` where the call must not be repeated."""
        # A connection that was never made carried nothing to the service.
        if not self._repeatable and not isinstance(error, httpx.ConnectError | httpx.ConnectTimeout):
            raise error
        return self._pause(error, None)

    def after_answer(self, response: httpx.Response) -> float | None:
        """None for an answer to keep, else the pause in seconds. Raises ``ClientError`` for a refusal that stands."""
        if response.status_code < 400:
            return None
        error = refusal(response)
        again = response.status_code in _NOTHING_CHANGED or (self._repeatable and response.status_code in _GATEWAY)
        if not again:
            raise error
        return self._pause(error, _seconds(response.headers.get("retry-after")))

    def after_refusal(self, error: RefusedError) -> float:
        """Pause after a refusal in the middle of a long answer. Raises ``error`` where it stands."""
        if not (self._repeatable and error.status in _NOTHING_CHANGED):
            raise error
        asked = error.problem.get("retry_after_s")
        return self._pause(error, float(asked) if isinstance(asked, int | float) else None)

    def _pause(self, error: Exception, asked_s: float | None) -> float:
        self.failures += 1
        if self.failures >= self._retries.attempts:
            raise error
        return self._retries.pause_s(self.failures, asked_s)


class TryLaterError(Exception):
    """Internal: a stream could not be opened now; after ``pause_s`` it may be tried again."""

    def __init__(self, pause_s: float) -> None:
        self.pause_s = pause_s
        super().__init__(f"again after {pause_s:.1f} s")


def _seconds(text: str | None) -> float | None:
    return float(text) if text is not None and text.isdigit() else None

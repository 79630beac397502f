"""How many calls one key and one tenant have under way: whoever has many is refused, and others find places."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager

from service.access.principal import LOCAL, Principal
from service.errors import RateLimitedError
from service.settings import Settings


class UnderWay:
    """Counts calls from when it is known who calls until they are answered."""

    def __init__(self, settings: Settings) -> None:
        self._most = {
            "SKYPOSE_MAX_KEY_CALLS": settings.max_key_calls,
            "SKYPOSE_QUOTA_CALLS": settings.quota_calls,
            "SKYPOSE_QUOTA_HEAVY_READS": settings.quota_heavy_reads,
        }
        self._taken: Counter[tuple[str, ...]] = Counter()

    @contextmanager
    def take(self, caller: Principal, *, heavy: bool) -> Iterator[None]:
        """Count a call until the block ends. Raises ``RateLimitedError`` where the caller has too many.

        Where no key is needed there is one caller, and nobody to leave a place to.
        """
        places = [] if caller == LOCAL else self._places(caller, heavy)
        for place in places:
            setting, most = place[0], self._most[place[0]]
            if 0 < most <= self._taken[place]:
                raise RateLimitedError("too many calls of this caller are under way", limit=most, setting=setting)
        self._taken.update(places)
        try:
            yield
        finally:
            self._taken.subtract(places)
            for place in places:
                if not self._taken[place]:
                    del self._taken[place]

    def _places(self, caller: Principal, heavy: bool) -> list[tuple[str, ...]]:
        places = [
            ("SKYPOSE_MAX_KEY_CALLS", caller.tenant, caller.key_id),
            ("SKYPOSE_QUOTA_CALLS", caller.tenant),
        ]
        return [*places, ("SKYPOSE_QUOTA_HEAVY_READS", caller.tenant)] if heavy else places

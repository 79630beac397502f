"""What a worker keeps: the last few values by content key, all of which can be made again."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable
from typing import Generic, TypeVar

V = TypeVar("V")


class Cache(Generic[V]):
    """The last few values by content key; what leaves is released."""

    def __init__(
        self,
        size: int,
        release: Callable[[V], None] = lambda value: None,
        weigh: Callable[[V], int] = lambda value: 0,
        most_bytes: int = 0,
    ) -> None:
        """At most ``size`` values, together at most ``most_bytes`` of what ``weigh`` says; the last one in any case."""
        self._values: OrderedDict[str, V] = OrderedDict()
        self._size, self._release = size, release
        self._weigh, self._most_bytes = weigh, most_bytes
        self._bytes = 0

    def get(self, key: str, make: Callable[[], V]) -> V:
        """The value of ``key``, made when it is not there."""
        if key not in self._values:
            value = make()
            self._values[key] = value
            self._bytes += self._weigh(value)
            while len(self._values) > 1 and (len(self._values) > self._size or self._bytes > self._most_bytes):
                _, left = self._values.popitem(last=False)
                self._bytes -= self._weigh(left)
                self._release(left)
        self._values.move_to_end(key)
        return self._values[key]

    def forget(self, key: str) -> None:
        """Drop a value that is broken, without releasing it."""
        if key in self._values:
            self._bytes -= self._weigh(self._values.pop(key))

    def clear(self) -> None:
        """Release everything."""
        for value in self._values.values():
            self._release(value)
        self._values.clear()
        self._bytes = 0

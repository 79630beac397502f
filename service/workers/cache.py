"""What a worker keeps: the last few values by content key, all of which can be made again."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable
from typing import Generic, TypeVar

V = TypeVar("V")


class Cache(Generic[V]):
    """The last few values by content key; what leaves is released."""

    def __init__(self, size: int, release: Callable[[V], None] = lambda value: None) -> None:
        self._values: OrderedDict[str, V] = OrderedDict()
        self._size, self._release = size, release

    def get(self, key: str, make: Callable[[], V]) -> V:
        """The value of ``key``, made when it is not there."""
        if key not in self._values:
            value = make()
            self._values[key] = value
            if len(self._values) > self._size:
                self._release(self._values.popitem(last=False)[1])
        self._values.move_to_end(key)
        return self._values[key]

    def forget(self, key: str) -> None:
        """Drop a value that is broken, without releasing it."""
        self._values.pop(key, None)

    def clear(self) -> None:
        """Release everything."""
        for value in self._values.values():
            self._release(value)
        self._values.clear()

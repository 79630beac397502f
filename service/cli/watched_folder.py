"""Which files of a folder are complete and not taken yet. No clock in here: it is told what time it is."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

from service.remote.media import in_order, media_type_of

Stamp = tuple[int, int]  # bytes, nanoseconds of the last change


@dataclass
class WatchedFolder:
    """Image and video files of a folder, in the order of their names.

    A file is complete when it has not changed for ``settle_s``. Later ones wait for it, so that frames keep
    their order. Hidden files are passed over: most programs write under such a name first, then rename.
    """

    folder: Path
    settle_s: float
    _changed: dict[str, tuple[Stamp, float]] = field(default_factory=dict)
    _taken: dict[str, Stamp] = field(default_factory=dict)

    def ready(self, now_s: float) -> list[Path]:
        """Complete files that were not taken. ``now_s``: seconds since the epoch, as file times count."""
        found = []
        for path in self._files():
            stamp = _stamp(path)
            if stamp is None or self._taken.get(path.name) == stamp:
                continue
            known, since_s = self._changed.get(path.name, (None, stamp[1] / 1e9))
            if known is not None and known != stamp:
                since_s = now_s
            self._changed[path.name] = (stamp, since_s)
            if now_s - since_s < self.settle_s:
                break
            found.append(path)
        return found

    def take(self, path: Path) -> None:
        """The file is dealt with. If it changes later it counts as another."""
        known = self._changed.pop(path.name, None)
        if known is not None:
            self._taken[path.name] = known[0]

    @property
    def waiting(self) -> int:
        """Files that are there and not taken."""
        return sum(self._taken.get(path.name) != _stamp(path) for path in self._files())

    def _files(self) -> list[Path]:
        names = (path for path in self.folder.iterdir() if not path.name.startswith("."))
        return in_order(path for path in names if media_type_of(path.name) is not None)


def _stamp(path: Path) -> Stamp | None:
    try:
        found = path.stat()
    except FileNotFoundError:  # gone since the folder was listed
        return None
    return found.st_size, found.st_mtime_ns

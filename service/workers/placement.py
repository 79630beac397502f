"""Which worker takes a session's next job: its own, unless another would have it done sooner.

Any worker may take any job, since a job brings its state; a worker's caches only make it faster. So a session stays
where it is while that costs it nothing, goes where there is room when it would have to wait, and leaves a worker
that is lost or drained.
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Iterable
from dataclasses import dataclass, field

KNOWN_MODELS = 8  # of a worker: as many as its cache holds
KNOWN_SESSIONS = 100_000
UNKNOWN_MODEL = 1  # jobs: preparing a model is worth it for every worker that would have nothing to do
MEMORY_STEP = 256 << 20  # bytes: less than this is no reason to prefer a worker
BUSIER = 2  # jobs more than elsewhere, for which a session leaves a worker where others are busy too


@dataclass
class _Place:
    out: bool = False  # takes no jobs
    load: int = 0  # jobs under way or waiting
    sessions: int = 0  # that live there
    memory: int = 0  # steps of ``MEMORY_STEP``, as the worker told last
    models: OrderedDict[str, None] = field(default_factory=OrderedDict)


class Placement:
    """Loads, homes and warm caches. Used by one thread, the event loop's."""

    def __init__(self, workers: Iterable[str] = ()) -> None:
        self._places: dict[str, _Place] = {worker: _Place() for worker in workers}
        self._homes: OrderedDict[str, str] = OrderedDict()

    @property
    def workers(self) -> tuple[str, ...]:
        """Those that take jobs."""
        return tuple(worker for worker, place in self._places.items() if not place.out)

    def add(self, worker: str, models: Iterable[str] = ()) -> None:
        """A worker that is ready, with these models prepared: a new one, or one that was removed and began anew."""
        place = self._places.setdefault(worker, _Place())
        place.out, place.memory = False, 0
        place.models = OrderedDict.fromkeys(models)

    def remove(self, worker: str) -> None:
        """A worker that takes no more jobs; its sessions move with their next one. Those in hand still end."""
        self._places[worker].out = True

    def forget(self, worker: str) -> None:
        """The worker began anew: its caches are empty."""
        self._places[worker].models.clear()

    def weigh(self, worker: str, memory_bytes: int) -> None:
        """What a worker's processes take of memory."""
        self._places[worker].memory = memory_bytes // MEMORY_STEP

    def take(self, session: str | None, model: str | None, avoid: str | None = None) -> str:
        """The worker for a job, which counts for its load until ``done``; ``session`` None: of no session.

        ``avoid`` gets it only where there is no other. Raises ``LookupError`` where there is no worker.
        """
        if not self.workers:
            raise LookupError("no worker is left")
        worker = self._choose(None if session is None else self._homes.get(session), model, avoid)
        if session is not None:
            self._settle(session, worker)
        place = self._places[worker]
        place.load += 1
        if model is not None:
            place.models[model] = None
            place.models.move_to_end(model)
            if len(place.models) > KNOWN_MODELS:
                place.models.popitem(last=False)
        return worker

    def done(self, worker: str) -> None:
        """A job has ended, well or not."""
        self._places[worker].load -= 1

    def load(self, worker: str) -> int:
        """Jobs under way or waiting at a worker."""
        return self._places[worker].load

    def sessions(self, worker: str) -> int:
        """Sessions that live at a worker."""
        return self._places[worker].sessions

    def _choose(self, home: str | None, model: str | None, avoid: str | None) -> str:
        def cost(worker: str) -> tuple[int, int, int, int]:
            place = self._places[worker]
            prepares = UNKNOWN_MODEL if model is not None and model not in place.models else 0
            return place.load + prepares, place.memory, len(place.models), place.sessions

        best = min([worker for worker in self.workers if worker != avoid] or self.workers, key=cost)
        if home is None or home == avoid or self._places[home].out:
            return best
        waiting, elsewhere = cost(home)[0], cost(best)[0]
        return best if waiting > elsewhere == 0 or waiting - elsewhere >= BUSIER else home

    def _settle(self, session: str, worker: str) -> None:
        before = self._homes.get(session)
        if before != worker:
            if before is not None:
                self._places[before].sessions -= 1
            self._places[worker].sessions += 1
        self._homes[session] = worker
        self._homes.move_to_end(session)
        if len(self._homes) > KNOWN_SESSIONS:
            _, left = self._homes.popitem(last=False)
            self._places[left].sessions -= 1

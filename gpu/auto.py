"""The default scorer: the fastest of several that give the same bits, and the next one when a device is lost."""

from __future__ import annotations

import time
import warnings
from collections.abc import Callable, Sequence

from gpu.errors import DeviceError, DeviceLostError
from gpu.looping import Floats, LoopingScorer, Map, Transforms

TRIAL_PARTICLES = 512
TRIALS = 3


class AutoScorer(LoopingScorer):
    """Opens the first of ``openers`` that works; with several devices, tries them on the first particles to score.

    Only scorers that give the same bits belong here, so that neither the trial nor the loss of a device changes an
    answer. ``openers`` are called at most once, in order. Owned, used and closed by one thread.
    """

    def __init__(self, openers: Sequence[Callable[[], LoopingScorer]]) -> None:
        self._openers = list(openers)
        self._opened: list[LoopingScorer] = []  # fastest first, once they were tried
        self._tried: set[tuple[int, int]] = set()
        self.lost = False  # a device has failed since; what scores now may be slower
        self._first()

    @property
    def name(self) -> str:  # type: ignore[override]  # of the scorer in use, so it may change
        """Of the scorer in use."""
        return self._first().name

    @property
    def in_use(self) -> LoopingScorer:
        """The scorer that answers at present."""
        return self._first()

    def score(self, part_transforms: Transforms, log_ratio: Map) -> Floats:
        """See ``Scorer.score``."""
        self._calibrate(part_transforms, log_ratio)
        return self._ask(lambda scorer: scorer.score(part_transforms, log_ratio))

    def score_many(self, part_transforms: Transforms, maps: Map) -> Floats:
        """See ``Scorer.score_many``."""
        return self._ask(lambda scorer: scorer.score_many(part_transforms, maps))

    def close(self) -> None:
        """Release all devices."""
        while self._opened:
            self._opened.pop().close()

    def _ask(self, question: Callable[[LoopingScorer], Floats]) -> Floats:
        """The first scorer's answer; if its device is lost, the next one's, so that no frame is."""
        while True:
            scorer = self._first()
            try:
                return question(scorer)
            except DeviceLostError as error:
                self._opened.remove(scorer)
                self.lost = True
                if not (self._opened or self._openers):
                    raise
                warnings.warn(f"{error}; going on with {self._first().name}", RuntimeWarning, stacklevel=3)

    def _first(self) -> LoopingScorer:
        while not self._opened:
            if not self._openers:
                raise DeviceError("no scorer is left: every device failed")
            self._open_next()
        return self._opened[0]

    def _open_next(self) -> None:
        opener = self._openers.pop(0)
        try:
            self._opened.append(opener())
        except DeviceError as error:
            if not (self._opened or self._openers):
                raise
            warnings.warn(f"a scorer cannot be opened: {error}", RuntimeWarning, stacklevel=4)

    def _calibrate(self, part_transforms: Transforms, log_ratio: Map) -> None:
        """Order the devices by their time for this size of image; the reference, opened last, is never tried."""
        shape = (log_ratio.shape[0], log_ratio.shape[1])
        while len(self._openers) > 1:
            self._open_next()
        if shape in self._tried or len(self._opened) < 2 or len(part_transforms) == 0:
            return
        self._tried.add(shape)
        some = part_transforms[:TRIAL_PARTICLES]
        times = {id(scorer): _time(scorer, some, log_ratio) for scorer in self._opened}
        self._opened.sort(key=lambda scorer: times[id(scorer)])


def _time(scorer: LoopingScorer, part_transforms: Transforms, log_ratio: Map) -> float:
    """Seconds of the fastest of a few calls after a first; infinite for a device that is lost on the way."""
    try:
        scorer.score(part_transforms, log_ratio)
        times = []
        for _ in range(TRIALS):
            began = time.perf_counter()
            scorer.score(part_transforms, log_ratio)
            times.append(time.perf_counter() - began)
    except DeviceLostError:
        return float("inf")
    return min(times)

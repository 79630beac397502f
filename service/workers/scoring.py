"""A session's scorer: one per model and backend, the time it takes, and its failures in the service's own words."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import numpy as np
from numpy.typing import NDArray

from gpu.auto import AutoScorer
from gpu.errors import DeviceError, DeviceLostError, ImageSizeError, ScorerError
from gpu.mesh import Mesh
from gpu.scorer import Scorer
from service.errors import BackendMissingError, ScorerFailedError, TooLargeError
from service.inference.articulation import Articulation, part_transforms
from service.inference.state import Array, Poses
from service.workers.cache import Cache
from service.workers.shared_scorer import MOST_PARTICLES, Opener, open_alone

TRANSFORMS_BYTES = 16 << 20  # of one call's transforms, so that a million particles need no gigabyte for theirs
TRANSFORM_BYTES = 48  # of one part
REOPEN_S = 60.0


class Scorers:
    """Open scorers by model and backend. Owned, used and closed by one thread.

    An ``auto`` scorer that has lost a device goes on with a slower one; after ``REOPEN_S`` it is opened anew, since a
    device that had failed once may be well again. Neither changes an answer: all that it uses give the same bits.
    """

    def __init__(self, size: int, clock: Callable[[], float] = time.monotonic, opener: Opener | None = None) -> None:
        """``opener`` opens the scorers of sessions whose particles do not fill a device."""
        self._kept: Cache[Scorer] = Cache(size, lambda scorer: scorer.close())
        self._clock = clock
        self._opener = opener
        self._reopen_at: dict[str, float] = {}

    @contextmanager
    def lend(self, model: str, backend: str, mesh: Mesh, particles: int) -> Iterator[Scorer]:
        """The scorer of a model, for a session of so many particles.

        One that fails is not lent again: the next frame opens another.

        Raises ``BackendMissingError`` where this machine does not have the backend, ``ScorerFailedError`` where it
        failed during the frame, ``TooLargeError`` where the image is larger than it can take.
        """
        shares = self._opener is not None and particles < MOST_PARTICLES
        key = f"{model}:{backend}:{'shared' if shares else 'alone'}"
        if self._clock() >= self._reopen_at.get(key, np.inf):
            del self._reopen_at[key]
            self._kept.forget(key)
        try:
            open_one = self._opener if shares and self._opener else open_alone
            scorer = self._kept.get(key, lambda: open_one(model, backend, mesh))
        except DeviceError as error:
            raise BackendMissingError(str(error), field="filter.backend", backend=backend) from error
        try:
            yield scorer
        except ImageSizeError as error:
            raise TooLargeError(str(error), field="body", limit=error.limit) from error
        except ScorerError as error:
            if isinstance(error, DeviceLostError):
                self._kept.forget(key)
            hint = "" if backend == "auto" else "; a session whose filter.backend is auto would go on with another"
            raise ScorerFailedError(f"{error}{hint}", backend=backend) from error
        if isinstance(scorer, AutoScorer) and scorer.lost:
            self._reopen_at.setdefault(key, self._clock() + REOPEN_S)

    def close(self) -> None:
        """Release every device."""
        self._kept.clear()


class TimedScorer:
    """``score`` of ``inference.step`` over a scorer, with the time it took; ``log_ratio`` (H, W)."""

    def __init__(self, scorer: Scorer, articulation: Articulation, log_ratio: NDArray[np.float32]) -> None:
        self._scorer, self.articulation, self._log_ratio = scorer, articulation, log_ratio
        self._batch = max(1, TRANSFORMS_BYTES // (TRANSFORM_BYTES * max(1, len(articulation.parts))))
        self.seconds = 0.0

    def __call__(self, poses: Poses) -> Array:
        """(N,) sums of the map under each silhouette."""
        parts = self.batches(poses)  # the transforms of one at a time
        return np.concatenate([self.sums(part_transforms(self.articulation, one), self._log_ratio) for one in parts])

    def batches(self, poses: Poses) -> list[Poses]:
        """The poses in parts whose transforms need no more than ``TRANSFORMS_BYTES``; at least one part."""
        return [poses[slice(k, k + self._batch)] for k in range(0, max(1, len(poses)), self._batch)]

    def sums(self, transforms: NDArray[np.float32], a_map: NDArray[np.float32]) -> Array:
        """(N,) sums of any (H, W) map under silhouettes that are transformed already, (N, P, 3, 4)."""
        began = time.perf_counter()
        scores = self._scorer.score(transforms, a_map)
        self.seconds += time.perf_counter() - began
        return scores

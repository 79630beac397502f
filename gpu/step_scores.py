"""Scores for transforms that lie on the device."""

from __future__ import annotations

from typing import Protocol

import numpy as np
import pyopencl as cl
from numpy.typing import NDArray

from gpu.auto import AutoScorer
from gpu.device import DeviceReport, open_device
from gpu.outline import OutlineScorer
from gpu.program import constant, device_errors
from gpu.scorer import Scorer

TRANSFORM_BYTES = 48
TOTAL_BITS = 52  # of the largest possible score: whole numbers that float64 holds exactly


class BufferScorer(Protocol):
    """Scores where the transforms are. Owned, used and closed by one thread."""

    name: str
    queue: cl.CommandQueue

    def score_buffer(self, transforms: cl.Buffer, n: int, log_ratio: NDArray[np.float32]) -> tuple[cl.Buffer, float]:
        """(n, P, 3, 4) float32 transforms, (H, W) map -> (n,) int64 scores in units, and the value of one unit.

        The unit depends on the map alone. Every score is finite and resolved.
        """

    def close(self) -> None:
        """Release the device."""


def on_device(scorer: Scorer) -> BufferScorer | None:
    """The scorer itself, or the one that an ``auto`` scorer uses at present, if it scores where the transforms are."""
    used = scorer.in_use if isinstance(scorer, AutoScorer) else scorer
    return used if isinstance(used, OutlineScorer) else None


class HostCopies:
    """Any scorer as a ``BufferScorer``: transforms are copied to the host, scores back to the device."""

    def __init__(self, scorer: Scorer, report: DeviceReport) -> None:
        self.name = f"{scorer.name} by host copies"
        with device_errors(self.name):
            self.queue = cl.CommandQueue(cl.Context([open_device(report)]))
        self._scorer = scorer

    def score_buffer(self, transforms: cl.Buffer, n: int, log_ratio: NDArray[np.float32]) -> tuple[cl.Buffer, float]:
        """See ``BufferScorer.score_buffer``."""
        on_host = np.empty((n, transforms.size // (TRANSFORM_BYTES * n), 3, 4), np.float32)
        cl.enqueue_copy(self.queue, on_host, transforms)
        scores = self._scorer.score(on_host, log_ratio)
        unit = smallest_unit(log_ratio)
        return constant(self.queue.context, np.rint(scores / unit).astype(np.int64)), unit

    def close(self) -> None:
        """Wait for the device; the scorer is its owner's to close."""
        self.queue.finish()


def smallest_unit(log_ratio: NDArray[np.float32]) -> float:
    """The power of two in which no silhouette's score needs more than ``TOTAL_BITS`` bits."""
    largest = float(np.abs(log_ratio, dtype=np.float64).sum())
    return float(np.exp2(np.ceil(np.log2(max(largest, 1e-290))) - TOTAL_BITS))

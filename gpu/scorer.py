"""The facade: open a scorer for a mesh, score particles against a map, close it."""

from __future__ import annotations

import warnings
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from gpu.device import find_devices, no_device_reason
from gpu.errors import DeviceError, DeviceLostError, ScorerError
from gpu.mesh import Mesh
from gpu.outline import OutlineScorer
from gpu.reference import reference_scores

__all__ = ["DeviceError", "DeviceLostError", "Scorer", "ScorerError", "open_scorer"]

Floats = NDArray[np.float64]
Transforms = NDArray[np.float32]
Map = NDArray[np.float32]

BACKENDS = ("auto", "outline", "reference")


class Scorer(Protocol):
    """Sums maps under silhouettes. Owned, used and closed by one thread.

    A map that is a read-only array is kept on the device: pass the same array again for the same frame.
    """

    name: str

    def score(self, part_transforms: Transforms, log_ratio: Map) -> Floats:
        """(N, P, 3, 4) transforms, (H, W) map -> (N,) sums over the pixels whose centre is covered."""

    def score_many(self, part_transforms: Transforms, maps: Map) -> Floats:
        """(N, P, 3, 4) transforms, (K, H, W) maps -> (N, K) sums."""

    def score_shifts(self, part_transforms: Transforms, log_ratio: Map, shifts: NDArray[np.integer]) -> Floats:
        """(N, P, 3, 4), (H, W), (S, 2) whole pixels dx, dy -> (N, S) sums under the shifted silhouettes."""

    def close(self) -> None:
        """Release the device."""


class ReferenceScorer:
    """The NumPy twin as a scorer: the fallback where no OpenCL platform answers."""

    name = "numpy:reference"

    def __init__(self, mesh: Mesh) -> None:
        self._mesh = mesh

    def score(self, part_transforms: Transforms, log_ratio: Map) -> Floats:
        """See ``Scorer.score``."""
        return self.score_many(part_transforms, log_ratio[None])[:, 0]

    def score_many(self, part_transforms: Transforms, maps: Map) -> Floats:
        """See ``Scorer.score_many``."""
        return reference_scores(self._mesh, part_transforms, maps)

    def score_shifts(self, part_transforms: Transforms, log_ratio: Map, shifts: NDArray[np.integer]) -> Floats:
        """See ``Scorer.score_shifts``."""
        scores = np.empty((len(part_transforms), len(shifts)))
        for k, shift in enumerate(shifts):
            moved = part_transforms.copy()
            moved[:, :, :2, 3] += shift
            scores[:, k] = self.score(moved, log_ratio)
        return scores

    def close(self) -> None:
        """Nothing to release."""


def open_scorer(mesh: Mesh, *, backend: str = "auto") -> Scorer:
    """Open a scorer for ``mesh``; ``auto`` takes OpenCL where a device answers, else the reference (and warns)."""
    if backend not in BACKENDS:
        raise ScorerError(f"scorer backend {backend!r} is not one of {', '.join(BACKENDS)}")
    if backend == "reference":
        return ReferenceScorer(mesh)
    usable = [report for report in find_devices() if report.rejected is None]
    if usable:
        return OutlineScorer(mesh, usable[0])
    if backend == "auto":
        warnings.warn(f"scoring without OpenCL, slowly: {no_device_reason()}", RuntimeWarning, stacklevel=2)
        return ReferenceScorer(mesh)
    raise DeviceError(no_device_reason())

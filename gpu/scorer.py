"""The facade: open a scorer for a mesh, score particles against a map, close it."""

from __future__ import annotations

import warnings
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from gpu.device import DeviceError, DeviceLostError, find_devices, no_device_reason
from gpu.mesh import Mesh
from gpu.outline import OutlineScorer
from gpu.reference import reference_scores

__all__ = ["DeviceLostError", "Scorer", "ScorerError", "open_scorer"]

BACKENDS = ("auto", "outline", "reference")


class ScorerError(RuntimeError):
    """A scorer cannot be opened or used; the message says why."""


class Scorer(Protocol):
    """Sums a map under silhouettes. Owned, used and closed by one thread."""

    name: str

    def score(
        self, part_transforms: NDArray[np.float32], log_ratio: NDArray[np.float32]
    ) -> NDArray[np.float64]:
        """(N, P, 3, 4) transforms, (H, W) map -> (N,) sums over the pixels whose centre is covered."""

    def close(self) -> None:
        """Release the device."""


class ReferenceScorer:
    """The NumPy twin as a scorer: the fallback where no OpenCL platform answers."""

    name = "numpy:reference"

    def __init__(self, mesh: Mesh) -> None:
        self._mesh = mesh

    def score(
        self, part_transforms: NDArray[np.float32], log_ratio: NDArray[np.float32]
    ) -> NDArray[np.float64]:
        """See ``Scorer.score``."""
        return reference_scores(self._mesh, part_transforms, log_ratio[None])[:, 0]

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
    raise ScorerError(no_device_reason()) from DeviceError()

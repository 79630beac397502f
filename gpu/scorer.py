"""The facade: open a scorer for a mesh, score particles against a map, close it."""

from __future__ import annotations

import warnings
from functools import partial
from typing import Protocol

import numpy as np

from gpu.auto import AutoScorer
from gpu.device import find_devices, no_device_reason
from gpu.errors import DeviceError, DeviceLostError, ScorerError
from gpu.fill import FillScorer
from gpu.looping import Floats, LoopingScorer, Map, Transforms
from gpu.mesh import Mesh
from gpu.opengl import OpenGLScorer
from gpu.outline import OutlineScorer
from gpu.prefix import fixed_point
from gpu.reference import reference_scores

__all__ = ["DeviceError", "DeviceLostError", "Scorer", "ScorerError", "open_scorer"]

BACKENDS = ("auto", "outline", "opengl", "cpu", "cpu-mt", "reference")


class Scorer(Protocol):
    """Sums maps under silhouettes. Owned, used and closed by one thread.

    A map that is a read-only array is kept on the device: pass the same array again for the same frame.
    """

    @property
    def name(self) -> str:
        """What scores, and on which device."""

    def score(self, part_transforms: Transforms, log_ratio: Map) -> Floats:
        """(N, P, 3, 4) transforms, (H, W) map -> (N,) sums over the pixels whose centre is covered."""

    def score_many(self, part_transforms: Transforms, maps: Map) -> Floats:
        """(N, P, 3, 4) transforms, (K, H, W) maps -> (N, K) sums."""

    def close(self) -> None:
        """Release the device."""


class ReferenceScorer(LoopingScorer):
    """The NumPy twin as a scorer: the fallback where no OpenCL platform answers."""

    name = "numpy:reference"

    def __init__(self, mesh: Mesh) -> None:
        self._mesh = mesh

    def score(self, part_transforms: Transforms, log_ratio: Map) -> Floats:
        """See ``Scorer.score``."""
        return self.score_many(part_transforms, log_ratio[None])[:, 0]

    def score_many(self, part_transforms: Transforms, maps: Map) -> Floats:
        """See ``Scorer.score_many``."""
        units = [fixed_point(one) for one in maps]  # the other scorers' units: their sums, bit for bit
        whole = reference_scores(self._mesh, part_transforms, np.stack([one for one, _ in units]))
        return np.asarray(whole * np.array([unit for _, unit in units]), dtype=np.float64)

    def close(self) -> None:
        """Nothing to release."""


def open_scorer(mesh: Mesh, *, backend: str = "auto") -> Scorer:
    """Open a scorer for ``mesh``.

    ========== =====================================================================================================
    auto       ``outline`` on the device that is fastest for the mesh and the image, tried on the first particles; when
               a device is lost, on the next one, at last ``reference`` (with a warning): the scores stay the same
    outline    OpenCL, by outlines: the fast one
    opengl     OpenGL draws the silhouettes, OpenCL sums under them: the paper's GPU row; its edges are OpenGL's
    cpu        fill the silhouette, on one core: the paper's first row
    cpu-mt     the same on all cores: its second
    reference  NumPy, slow and obvious
    ========== =====================================================================================================

    Raises ``ScorerError``, and ``DeviceError`` where a backend that was asked for has no device.
    """
    if backend not in BACKENDS:
        raise ScorerError(f"scorer backend {backend!r} is not one of {', '.join(BACKENDS)}")
    if backend == "reference":
        return ReferenceScorer(mesh)
    cpu_only = backend in ("cpu", "cpu-mt")
    usable = [r for r in find_devices() if r.rejected is None and (r.kind == "cpu" or not cpu_only)]
    if backend == "auto":
        if not usable:
            warnings.warn(f"scoring without OpenCL, slowly: {no_device_reason()}", RuntimeWarning, stacklevel=2)
        outlines = [partial(OutlineScorer, mesh, report) for report in usable]
        return AutoScorer([*outlines, partial(ReferenceScorer, mesh)])
    if not usable:
        raise DeviceError(f"backend {backend!r} has no device: {no_device_reason()}")
    if backend == "opengl":
        return OpenGLScorer(mesh, usable[0])
    if cpu_only:
        return FillScorer(mesh, usable[0], threads=1 if backend == "cpu" else None)
    return OutlineScorer(mesh, usable[0])

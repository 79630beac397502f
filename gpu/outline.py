"""OpenCL silhouette-edge scorer: the outline of every particle, summed through row prefix sums (no mask is drawn)."""

from __future__ import annotations

import numpy as np
import pyopencl as cl
from numpy.typing import NDArray

from gpu.budget import batches
from gpu.device import DeviceReport
from gpu.errors import ImageSizeError, ScorerError
from gpu.looping import Floats, LoopingScorer, Map, Transforms
from gpu.mesh import Mesh
from gpu.outline_cpu import unresolved
from gpu.outline_kernels import open_kernels
from gpu.prefix import MapCache, PrefixMaps
from gpu.program import constant, device_errors

LARGEST_SIDE = 8191  # rows and columns have 13 bits in the kernels
TRANSFORM_BYTES = 48


class OutlineScorer(LoopingScorer):
    """Scores on one OpenCL device. Owned, used and closed by one thread.

    ``kernel`` is ``"cpu"`` or ``"gpu"``; by default the device's kind decides.
    """

    def __init__(self, mesh: Mesh, report: DeviceReport, kernel: str | None = None) -> None:
        self.name = f"opencl:outline:{report.name}"
        self._parts = len(mesh.parts)
        self._each = TRANSFORM_BYTES * self._parts
        with device_errors(self.name):
            kernels = open_kernels(mesh, report, kernel)
            self.queue, self._by_group, self._by_item = kernels.queue, kernels.by_group, kernels.by_item
            self._maps = MapCache(self.queue.context)

    def score(self, part_transforms: Transforms, log_ratio: Map) -> Floats:
        """(N, P, 3, 4) transforms, (H, W) map -> (N,) sums of the map under the silhouettes."""
        return self.score_many(part_transforms, log_ratio)[:, 0]

    def score_many(self, part_transforms: Transforms, maps: Map) -> Floats:
        """(N, P, 3, 4) transforms, (H, W) or (K, H, W) maps -> (N, K): one outline, K sums."""
        transforms = self._checked(part_transforms, maps.shape[-2:])
        with device_errors(self.name):
            prefix = self._maps.load(maps)
            scores = np.empty((len(transforms), len(prefix.units)), np.int64)
            for batch in batches(self.queue.device, len(transforms), self._each + 8 * len(prefix.units)):
                scores[batch] = self._score(transforms[batch], prefix)
        return np.asarray(scores * prefix.units, dtype=np.float64)

    def score_buffer(self, transforms: cl.Buffer, n: int, log_ratio: Map) -> tuple[cl.Buffer, float]:
        """(n, P, 3, 4) float32 transforms where ``queue`` runs, (H, W) map -> (n,) int64 scores there, and the unit."""
        with device_errors(self.name):
            prefix = self._maps.load(log_ratio)
            out = cl.Buffer(self.queue.context, cl.mem_flags.READ_WRITE, 8 * max(1, n))
            if n:
                kernel = self._by_item or self._by_group
                kernel.score(transforms, n, prefix.buffer, 1, prefix.shape, out)
            if n and self._by_item is not None:
                self._resolve(transforms, n, prefix, out)
        return out, float(prefix.units[0])

    def close(self) -> None:
        """Wait for the device."""
        self.queue.finish()

    def _score(self, transforms: Transforms, prefix: PrefixMaps) -> NDArray[np.int64]:
        scores = np.empty((len(transforms), len(prefix.units)), np.int64)
        context = self.queue.context
        out = cl.Buffer(context, cl.mem_flags.WRITE_ONLY, scores.nbytes)
        kernel = self._by_item or self._by_group
        kernel.score(
            constant(context, transforms), len(transforms), prefix.buffer, len(prefix.units), prefix.shape, out
        )
        cl.enqueue_copy(self.queue, scores, out)
        crowded = unresolved(scores)
        if len(crowded):
            scores[crowded] = self._score_crowded(transforms[crowded], prefix)
        return scores

    def _score_crowded(self, transforms: Transforms, prefix: PrefixMaps) -> NDArray[np.int64]:
        """Particles that the kernel for CPUs had no room for."""
        scores = np.empty((len(transforms), len(prefix.units)), np.int64)
        out = cl.Buffer(self.queue.context, cl.mem_flags.WRITE_ONLY, scores.nbytes)
        on_device = constant(self.queue.context, transforms)
        self._by_group.score(on_device, len(transforms), prefix.buffer, len(prefix.units), prefix.shape, out)
        cl.enqueue_copy(self.queue, scores, out)
        return scores

    def _resolve(self, transforms: cl.Buffer, n: int, prefix: PrefixMaps, out: cl.Buffer) -> None:
        """Score the crowded ones of n particles again, on the device's side."""
        scores = np.empty((n, 1), np.int64)
        cl.enqueue_copy(self.queue, scores, out)
        crowded = unresolved(scores)
        if len(crowded):
            on_host = np.empty((n, self._parts, 3, 4), np.float32)
            cl.enqueue_copy(self.queue, on_host, transforms)
            scores[crowded] = self._score_crowded(on_host[crowded], prefix)
            cl.enqueue_copy(self.queue, out, scores)

    def _checked(self, part_transforms: Transforms, shape: tuple[int, ...]) -> Transforms:
        transforms = np.ascontiguousarray(part_transforms, dtype=np.float32)
        if transforms.shape[1:] != (self._parts, 3, 4):
            raise ScorerError(f"transforms are {transforms.shape}, not (N, {self._parts}, 3, 4)")
        if max(shape) > LARGEST_SIDE:
            message = f"an image of {shape[1]} x {shape[0]} is larger than {LARGEST_SIDE} a side"
            raise ImageSizeError(message, LARGEST_SIDE)
        return transforms

"""Silhouettes filled face by face on a CPU, one particle per thread: the paper's first two rows, and masks to see."""

from __future__ import annotations

import numpy as np
import pyopencl as cl
from numpy.typing import NDArray

from gpu.budget import batches
from gpu.device import DeviceReport, open_device
from gpu.faces import face_table
from gpu.looping import Floats, LoopingScorer, Map, Transforms
from gpu.mesh import Mesh
from gpu.prefix import fixed_point
from gpu.program import Kernel, KernelArgument, build, constant, device_errors, zero

WORD = 64  # pixels
TRANSFORM_BYTES = 48


class FillScorer(LoopingScorer):
    """Backends ``cpu`` (``threads=1``) and ``cpu-mt`` (all of the device's compute units)."""

    def __init__(self, mesh: Mesh, report: DeviceReport, threads: int | None = None) -> None:
        device = open_device(report)
        self._threads = min(threads or device.max_compute_units, device.max_compute_units)
        self.name = f"opencl:fill:{self._threads} of {device.max_compute_units} cores:{report.name}"
        table = face_table(mesh)
        self._parts = len(mesh.parts)
        self._most_vertices, self._most_faces = table.most_vertices, table.most_faces
        with device_errors(self.name):
            self._context = cl.Context([device])
            self._queue = cl.CommandQueue(self._context)
            program = build(self._context, "lanes.cl", "fill.cl")
            self._score, self._draw = (Kernel(program, name) for name in ("score", "draw"))
            arrays = (table.vertices.T, table.vertex_starts, table.faces, table.face_starts)
            self._table = tuple(constant(self._context, array) for array in arrays)

    def score(self, part_transforms: Transforms, log_ratio: Map) -> Floats:
        """(N, P, 3, 4) transforms, (H, W) map -> (N,) sums of the map under the silhouettes."""
        transforms = np.ascontiguousarray(part_transforms, dtype=np.float32)
        height, width = log_ratio.shape
        units, unit = fixed_point(log_ratio)
        padded = np.zeros((height, _words(width) * WORD), np.int32)
        padded[:, :width] = units
        scores = np.empty(len(transforms), np.int64)
        with device_errors(self.name):
            on_device = constant(self._context, padded)
            for batch in batches(self._queue.device, len(scores), TRANSFORM_BYTES * self._parts + 8):
                self._launch(self._score, transforms[batch], (on_device,), (height, width), scores[batch])
        return np.asarray(scores * unit, dtype=np.float64)

    def masks(self, part_transforms: Transforms, shape: tuple[int, int]) -> NDArray[np.bool_]:
        """(N, P, 3, 4) transforms -> (N, H, W) silhouettes."""
        transforms = np.ascontiguousarray(part_transforms, dtype=np.float32)
        out = np.empty((len(transforms), *shape), np.uint8)
        with device_errors(self.name):
            for batch in batches(self._queue.device, len(out), TRANSFORM_BYTES * self._parts + shape[0] * shape[1]):
                self._launch(self._draw, transforms[batch], (), shape, out[batch])
        return out.view(np.bool_)

    def close(self) -> None:
        """Wait for the device."""
        self._queue.finish()

    def _launch(
        self,
        kernel: Kernel,
        transforms: Transforms,
        given: tuple[cl.Buffer, ...],
        shape: tuple[int, int],
        result: NDArray[np.generic],
    ) -> None:
        each = shape[0] * _words(shape[1]) + (3 * self._most_vertices + self._most_faces) // 2 + 1
        memory = cl.Buffer(self._context, cl.mem_flags.READ_WRITE, 8 * each * self._threads)
        out = cl.Buffer(self._context, cl.mem_flags.WRITE_ONLY, result.nbytes)
        head: tuple[KernelArgument, ...]
        head = (constant(self._context, transforms), np.int32(len(transforms)), np.int32(self._parts), *self._table)
        size = (np.int32(shape[1]), np.int32(shape[0]))
        arguments: tuple[KernelArgument, ...] = (*head, np.int32(self._most_vertices), *given, *size, out)
        kernel(self._queue, (self._threads,), (1,), *arguments, memory, np.int32(each), zero(self._context))
        cl.enqueue_copy(self._queue, result, out)


def _words(width: int) -> int:
    return width // WORD + 1

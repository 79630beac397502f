"""OpenCL silhouette-edge scorer: the outline of every particle, summed through row prefix sums (no mask is drawn)."""

from __future__ import annotations

from importlib import resources

import numpy as np
import pyopencl as cl
from numpy.typing import NDArray

from gpu.device import DeviceLostError, DeviceReport
from gpu.edges import outline_edges
from gpu.mesh import Mesh
from gpu.prefix import fixed_point_prefix


class OutlineScorer:
    """Scores on one OpenCL device. Owned, used and closed by one thread."""

    def __init__(self, mesh: Mesh, report: DeviceReport) -> None:
        self.name = f"opencl:outline:{report.platform}:{report.name}"
        platform, index = report.index
        self._device = cl.get_platforms()[platform].get_devices()[index]
        self._context = cl.Context([self._device])
        self._queue = cl.CommandQueue(self._context)
        self._parts = len(mesh.parts)
        columns, counts = [], [0]
        for part in mesh.parts:
            edges = outline_edges(part.vertices, part.faces)
            a, b = (part.vertices[edges.ends[:, k]] for k in (0, 1))
            columns.append(np.hstack([a, b, edges.normal_a, edges.normal_b]).astype(np.float32))
            counts.append(counts[-1] + len(edges))
        table = np.concatenate(columns).T
        self._n_edges = table.shape[1]
        self._edges = self._constant(np.ascontiguousarray(table))
        self._edge_start = self._constant(np.array(counts, np.int32))
        self._shape: tuple[int, int] | None = None
        self._map: NDArray[np.float32] | None = None

    def score(
        self, part_transforms: NDArray[np.float32], log_ratio: NDArray[np.float32]
    ) -> NDArray[np.float64]:
        """(N, P, 3, 4) transforms, (H, W) map -> (N,) sums of the map under the silhouettes."""
        transforms = np.ascontiguousarray(part_transforms, dtype=np.float32)
        if transforms.shape[1:] != (self._parts, 3, 4):
            raise ValueError(f"transforms are {transforms.shape}, not (N, {self._parts}, 3, 4)")
        if len(transforms) == 0:
            return np.zeros(0)
        try:
            return self._run(transforms, log_ratio)
        except cl.RuntimeError as error:
            raise DeviceLostError(f"{self.name} failed: {error}") from error

    def close(self) -> None:
        """Wait for the device."""
        self._queue.finish()

    def _run(self, transforms: NDArray[np.float32], log_ratio: NDArray[np.float32]) -> NDArray[np.float64]:
        self._load_map(log_ratio)
        scores = np.empty(len(transforms), np.int64)
        out = cl.Buffer(self._context, cl.mem_flags.WRITE_ONLY, scores.nbytes)
        self._kernel(
            self._queue, (self._groups,), (1,),
            self._constant(transforms), np.int32(len(transforms)), self._edge_start, self._edges,
            np.int32(self._n_edges), self._prefix, out, self._diff, self._marks, self._constant(np.zeros(1, np.int32)),
        )  # fmt: skip
        cl.enqueue_copy(self._queue, scores, out)
        return scores * self._unit

    def _load_map(self, log_ratio: NDArray[np.float32]) -> None:
        if log_ratio is self._map and not log_ratio.flags.writeable:
            return
        if log_ratio.shape != self._shape:
            self._build(log_ratio.shape)
        prefix, unit = fixed_point_prefix(log_ratio[None])
        self._prefix, self._unit, self._map = self._constant(prefix), float(unit[0]), log_ratio

    def _build(self, shape: tuple[int, ...]) -> None:
        height, width = shape
        words = width // 64 + 1
        source = resources.files("gpu").joinpath("kernels/outline_cpu.cl").read_text()
        options = [
            f"-DPARTS={self._parts}",
            f"-DWIDTH={width}",
            f"-DHEIGHT={height}",
            "-DMAPS=1",
            f"-DWORDS={words}",
        ]
        self._kernel = cl.Kernel(cl.Program(self._context, source).build(options), "score")
        self._groups = self._device.max_compute_units
        self._diff = self._constant(np.zeros(self._groups * height * words * 64, np.int16))
        self._marks = self._constant(np.zeros(self._groups * height * words, np.uint64))
        self._shape = (height, width)

    def _constant(self, values: NDArray[np.generic]) -> cl.Buffer:
        flags = cl.mem_flags.READ_WRITE | cl.mem_flags.COPY_HOST_PTR
        return cl.Buffer(self._context, flags, hostbuf=values)

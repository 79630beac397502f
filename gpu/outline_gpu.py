"""Runs ``kernels/outline_gpu.cl``: work-groups that share a particle.

Also takes over, on any device, what the CPU kernel has no room for.
"""

from __future__ import annotations

import numpy as np
import pyopencl as cl

from gpu.budget import group_count
from gpu.outline_cpu import DeviceTable
from gpu.program import Kernel, build, zero

LARGEST_GROUP = 256
ROW_ITEMS = 32
GROUPS_PER_UNIT = 8
EDGE_BYTES = 16


class GpuOutline:
    """Scores batches with work-groups and local memory; runs on any device, is made for GPUs."""

    def __init__(self, queue: cl.CommandQueue, table: DeviceTable) -> None:
        self._queue, self._table = queue, table
        self._kernels: dict[tuple[int, int, bool], Kernel] = {}
        device = queue.device
        bytes_each = EDGE_BYTES * max(1, table.longest)
        limits = device.global_mem_size, device.max_mem_alloc_size
        self._groups = group_count(device.max_compute_units, GROUPS_PER_UNIT, bytes_each, *limits)
        self._memory = cl.Buffer(queue.context, cl.mem_flags.READ_WRITE, bytes_each * self._groups)

    def score(
        self,
        transforms: cl.Buffer,
        n: int,
        prefix: cl.Buffer,
        n_maps: int,
        shape: tuple[int, int],
        out: cl.Buffer,
        places: cl.Buffer | None = None,
    ) -> None:
        """Write (n, n_maps) int64 scores to ``out``; ``places`` (n,) int32: each one's set of maps in ``prefix``."""
        height, width = shape
        band_rows, stretch = self._layout(width)
        key = (n_maps, width, places is not None)
        if key not in self._kernels:
            self._kernels[key] = self._build(n_maps, band_rows, stretch, placed=places is not None)
        group = band_rows * ROW_ITEMS
        self._kernels[key](
            self._queue,
            (min(self._groups, n) * group,),
            (group,),
            transforms,
            np.int32(n),
            *self._table.arguments,
            prefix,
            np.int32(width),
            np.int32(height),
            out,
            self._memory,
            np.int32(self._table.longest),
            zero(self._queue.context),
            cl.LocalMemory(4 * band_rows * ROW_ITEMS * stretch),  # type: ignore[arg-type]  # missing in its stub
            *(() if places is None else (places,)),
        )

    def _layout(self, width: int) -> tuple[int, int]:
        """Rows per band and columns per work-item: as many rows as work-items and local memory allow."""
        stretch = -(-(width + 1) // ROW_ITEMS) | 1
        device = self._queue.device
        rows = min(LARGEST_GROUP, device.max_work_group_size) // ROW_ITEMS
        while rows > 1 and rows * ROW_ITEMS * (4 * stretch + 12) + 64 > device.local_mem_size:
            rows //= 2
        return rows, stretch

    def _build(self, n_maps: int, band_rows: int, stretch: int, placed: bool) -> Kernel:
        sizes = {"MAPS": n_maps, "BAND_ROWS": band_rows, "ROW_ITEMS": ROW_ITEMS, "STRETCH": stretch}
        options = [f"-D{name}={value}" for name, value in sizes.items()] + (["-DPLACED"] if placed else [])
        return Kernel(build(self._queue.context, "outline_gpu.cl", options=options), "score")

"""Sums a map under silhouettes drawn into an atlas (``kernels/reduce.cl``)."""

from __future__ import annotations

import numpy as np
import pyopencl as cl
from numpy.typing import NDArray

from gpu.atlas import LANES, Tiles
from gpu.prefix import fixed_point
from gpu.program import Kernel, build, constant

GPU_ITEMS = 64


class Reducer:
    """One map, many atlases."""

    def __init__(self, queue: cl.CommandQueue) -> None:
        self._queue = queue
        self._kernel = Kernel(build(queue.context, "lanes.cl", "reduce.cl"), "sum_tiles")
        self._items = 1 if queue.device.type & cl.device_type.CPU else GPU_ITEMS

    def load(self, log_ratio: NDArray[np.float32]) -> tuple[cl.Buffer, int, float]:
        """(H, W) map -> the map in whole units on the device, its padded width, and the value of one unit."""
        units, unit = fixed_point(log_ratio)
        padded = np.pad(units, ((0, 0), (0, LANES)))
        return constant(self._queue.context, padded), padded.shape[1], unit

    def sums(
        self, atlas: cl.Buffer, atlas_width: int, tiles: Tiles, loaded: tuple[cl.Buffer, int, float]
    ) -> NDArray[np.float64]:
        """(N,) sums under the tiles' silhouettes."""
        n = len(tiles.origins)
        scores = np.empty(n, np.int64)
        context = self._queue.context
        out = cl.Buffer(context, cl.mem_flags.WRITE_ONLY, scores.nbytes)
        self._kernel(
            self._queue,
            (n * self._items,),
            (self._items,),
            atlas,
            np.int32(atlas_width),
            np.int32(tiles.width),
            np.int32(tiles.height),
            np.int32(tiles.across(atlas_width)),
            constant(context, tiles.origins),
            loaded[0],
            np.int32(loaded[1]),
            out,
            cl.LocalMemory(8 * self._items),  # type: ignore[arg-type]  # missing in its stub
        )
        cl.enqueue_copy(self._queue, scores, out)
        return np.asarray(scores * loaded[2], dtype=np.float64)

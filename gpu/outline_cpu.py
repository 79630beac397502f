"""Runs ``kernels/outline_cpu.cl``: one persistent work-item per compute unit, with its scratch memory."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pyopencl as cl
from numpy.typing import NDArray

from gpu.clusters import OutlineTable
from gpu.program import Kernel, KernelArgument, build, constant, zero

LANES = 16
CONSTANTS = {"KEPT": 512, "TALL": 16, "TALL_SLOTS": 384, "SHORT_SLOTS": 512, "BAND_STRIDE": 1037}
NO_ROOM = np.iinfo(np.int64).min  # score of a particle with more crossings in a row than there are slots


@dataclass(frozen=True)
class DeviceTable:
    """An ``OutlineTable`` on the device."""

    blocks: cl.Buffer
    starts: cl.Buffer
    lists: cl.Buffer
    across: int
    n_parts: int
    longest: int  # upper limit of the edges that one particle looks at

    @classmethod
    def upload(cls, context: cl.Context, table: OutlineTable, n_parts: int) -> DeviceTable:
        """Copy the table to the device."""
        per_cell = np.diff(table.starts).reshape(n_parts, -1)
        longest = LANES * int(per_cell.max(axis=1).sum())
        arrays = (table.blocks, table.starts, table.lists)
        blocks, starts, lists = (constant(context, a) for a in arrays)
        return cls(blocks, starts, lists, table.across, n_parts, longest)

    @property
    def arguments(self) -> tuple[KernelArgument, ...]:
        """As the kernels take them."""
        return np.int32(self.n_parts), self.blocks, self.starts, self.lists, np.int32(self.across)


class CpuOutline:
    """Scores batches on a CPU device."""

    def __init__(self, queue: cl.CommandQueue, table: DeviceTable) -> None:
        self._queue, self._table = queue, table
        self._score = Kernel(self._build(), "score")
        self._score_placed: Kernel | None = None
        self._groups = queue.device.max_compute_units
        self._memory: tuple[tuple[int, int], cl.Buffer, int] | None = None

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
        memory, each = self._scratch(shape)
        sizes = (np.int32(n_maps), np.int32(width), np.int32(height))
        tail = (out, memory, np.int32(each), zero(self._queue.context))
        head = (transforms, np.int32(n), *self._table.arguments, prefix, *sizes, *tail)
        if places is None:
            self._launch(self._score, *head)
            return
        if self._score_placed is None:
            self._score_placed = Kernel(self._build("-DPLACED"), "score")
        self._launch(self._score_placed, *head, places)

    def _build(self, *more: str) -> cl.Program:
        options = [f"-D{name}={value}" for name, value in CONSTANTS.items()]
        return build(self._queue.context, "lanes.cl", "sorting.cl", "outline_cpu.cl", options=[*options, *more])

    def _launch(self, kernel: Kernel, *arguments: KernelArgument) -> None:
        kernel(self._queue, (self._groups,), (1,), *arguments)

    def _scratch(self, shape: tuple[int, int]) -> tuple[cl.Buffer, int]:
        """Scratch memory for images of this shape, and the numbers (int32) of one work-item."""
        if self._memory is None or self._memory[0] != shape:
            each = scratch_size(*shape)
            size = 4 * each * self._groups
            self._memory = shape, cl.Buffer(self._queue.context, cl.mem_flags.READ_WRITE, size), each
        return self._memory[1:]


def scratch_size(height: int, width: int) -> int:
    """Numbers (int32) that ``take_scratch`` in the kernel hands out, rounded up to whole cache lines."""
    c = CONSTANTS
    bands = -(-height // LANES)
    slots = (c["KEPT"] + bands * c["BAND_STRIDE"] + c["KEPT"] * c["TALL"]) * LANES
    ends = bands * LANES + (bands + LANES) // LANES * LANES
    lists = 4 * c["KEPT"] + 2 * (c["KEPT"] * c["TALL"] + LANES)
    found = (c["TALL_SLOTS"] + c["SHORT_SLOTS"] + 2) * LANES
    return -(-(slots + ends + lists + found) // 32) * 32


def unresolved(scores: NDArray[np.int64]) -> NDArray[np.int64]:
    """Which rows of (N, ...) scores had no room."""
    return np.flatnonzero((scores.reshape(len(scores), -1) == NO_ROOM).any(axis=1))

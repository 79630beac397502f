"""Which pieces of a part need not be drawn in a cell, because another piece covers them from all its directions."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pyopencl as cl
from numpy.typing import NDArray

from gpu.cells import cell_count
from gpu.components import Component
from gpu.program import Kernel, build, constant

SLACK = 1e-4  # of the part's extent, for rounding


class Occlusion:
    """Asks the device; see ``kernels/occlusion.cl`` for why the answer is exact."""

    def __init__(self, queue: cl.CommandQueue) -> None:
        self._queue = queue
        self._kernel = Kernel(build(queue.context, "occlusion.cl"), "find_hidden")

    def hidden_pieces(
        self,
        vertices: NDArray[np.float64],
        pieces: Sequence[Component],
        possible: Sequence[NDArray[np.bool_]],
        across: int,
    ) -> NDArray[np.bool_]:
        """(cells, K) True where piece k is covered. ``possible``: per piece (cells, E), edges that may be outline."""
        context = self._queue.context
        hidden = np.zeros((cell_count(across), len(pieces)), np.uint8)
        out = cl.Buffer(context, cl.mem_flags.WRITE_ONLY, hidden.nbytes)
        ends = np.concatenate([vertices[p.edges.ends].reshape(-1, 6) for p in pieces]).astype(np.float32)
        corners = np.concatenate([vertices[p.faces].reshape(-1, 9) for p in pieces]).astype(np.float32)
        slack = SLACK * float(np.ptp(vertices, axis=0).max())
        self._kernel(
            self._queue,
            hidden.shape,
            None,
            np.int32(across),
            np.int32(len(pieces)),
            constant(context, np.stack([p.box.reshape(12) for p in pieces]).astype(np.float32)),
            constant(context, _starts([len(p.edges) for p in pieces])),
            constant(context, ends),
            constant(context, np.hstack(list(possible)).astype(np.uint8)),
            constant(context, _starts([len(p.faces) for p in pieces])),
            constant(context, corners),
            np.float32(slack),
            out,
        )
        cl.enqueue_copy(self._queue, hidden, out)
        return hidden.astype(bool)


def _starts(counts: Sequence[int]) -> NDArray[np.int32]:
    return np.concatenate([[0], np.cumsum(counts)]).astype(np.int32)

"""Derivatives of many blurred pictures at once: ``kernels/light_slopes.cl``.

Knows pictures, not what they mean: see docs/model.md, section 3. The readable twin is
``service.inference.model.derivatives.mixed``.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pyopencl as cl
from numpy.typing import NDArray

from gpu.device import DeviceReport, first_device, open_device
from gpu.evidence_terms import LANES
from gpu.program import Scratch, build, constant, device_errors, work_items, zero

Numbers = NDArray[np.float32]
FILES = ("lanes.cl", "evidence_pictures.cl", "light_slopes.cl")


class LightSlopes:
    """One OpenCL device. Owned, used and closed by one thread."""

    def __init__(self, report: DeviceReport) -> None:
        self.name = f"opencl:slopes:{report.name}"
        with device_errors(self.name):
            self._context = cl.Context([open_device(report)])
            self._queue, self._memory = cl.CommandQueue(self._context), Scratch(self._context)
            self._kernel = cl.Kernel(build(self._context, *FILES), "slopes")

    def mixed(
        self,
        pairs: Numbers,
        here: Numbers | None,
        middles: NDArray[np.floating],
        mixes: NDArray[np.floating],
        blur: Sequence[tuple[float, Numbers, Numbers]],
    ) -> Numbers:
        """(N, D, S, S) sums ``mixes`` (N, D, M) of what N poses' pictures change by, each of them blurred.

        ``pairs`` (N, 2, K, S, S): pictures whose differences are the first K of the M; ``here`` (N, S, S): that whose
        change by place, growth and turn about ``middles`` (N, 2; px) are the other four, or None. ``blur``: weight,
        taps of each Gaussian, and those of its slope.
        """
        n, side = len(pairs), pairs.shape[-1]
        out = np.zeros((n, mixes.shape[1], side, side), np.float32)
        if side % LANES:
            raise ValueError(f"a side of {side} pixels is no multiple of {LANES}")
        if n:
            with device_errors(self.name):
                self._run(pairs, here, (mixes, middles), blur, out)
        return out

    def close(self) -> None:
        """Wait for the device and give its memory back."""
        self._queue.finish()
        self._memory.close()

    def _run(
        self,
        pairs: Numbers,
        here: Numbers | None,
        numbers: tuple[NDArray[np.floating], NDArray[np.floating]],
        blur: Sequence[tuple[float, Numbers, Numbers]],
        out: Numbers,
    ) -> None:
        n, _, drawn, side, _ = pairs.shape
        radii = np.array([max(len(smooth), len(slope)) // 2 for _, smooth, slope in blur], np.int32)
        length = side + 2 * (-(-int(radii.max()) // LANES) * LANES)
        each = (drawn + 5) * side * side + side * length
        items = work_items(self._queue.device, n, 4 * each)
        flags = cl.mem_flags
        given = [
            None if one is None else cl.Buffer(self._context, flags.READ_ONLY | flags.USE_HOST_PTR, hostbuf=one)
            for one in (np.ascontiguousarray(pairs), None if here is None else np.ascontiguousarray(here))
        ]
        result = cl.Buffer(self._context, flags.READ_WRITE | flags.USE_HOST_PTR, hostbuf=out)
        mixes, middles = (constant(self._context, np.ascontiguousarray(one, np.float32)) for one in numbers)
        weights = constant(self._context, np.array([weight for weight, _, _ in blur], np.float32))
        both = [smooth for _, smooth, _ in blur], [slope for _, _, slope in blur]
        smooth, slope = (
            constant(self._context, np.concatenate([_padded(one, r) for one, r in zip(taps, radii, strict=True)]))
            for taps in both
        )
        counts = (np.int32(n), np.int32(drawn), np.int32(out.shape[1]))
        sizes = (np.int32(side), np.int32(len(blur)))
        spread = weights, constant(self._context, radii), smooth, slope, np.int32(length)
        tail = result, self._memory.of(4 * each * items), np.uint64(each), zero(self._context)
        self._kernel(self._queue, (items,), (1,), *given, *counts, mixes, middles, *sizes, *spread, *tail)
        mapped, _ = cl.enqueue_map_buffer(self._queue, result, cl.map_flags.READ, 0, out.shape, out.dtype)
        mapped.base.release(self._queue)
        self._queue.finish()


def _padded(taps: Numbers, radius: int) -> Numbers:
    """(2 radius + 1,) with zeros beyond both ends."""
    return np.pad(np.asarray(taps, np.float32), radius - len(taps) // 2)


def open_slopes(kind: str = "cpu") -> LightSlopes:
    """On the first usable device of this kind. Raises ``DeviceError`` where OpenCL has none."""
    return LightSlopes(first_device(kind))

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
from gpu.evidence import EIGHT, Row
from gpu.evidence_terms import LANES
from gpu.program import (
    Kernel,
    Scratch,
    build,
    constant,
    device_errors,
    landed,
    landing,
    landings,
    lent,
    work_items,
    zero,
)

Numbers = NDArray[np.float32]
FILES = ("lanes.cl", "evidence_shared.cl", "evidence_pictures.cl", "evidence_normal.cl", "light_slopes.cl")
_TILE = 384  # as the kernel has it


class LightSlopes:
    """One OpenCL device. Owned, used and closed by one thread."""

    def __init__(self, report: DeviceReport) -> None:
        self.name = f"opencl:slopes:{report.name}"
        with device_errors(self.name):
            self._context = cl.Context([open_device(report)])
            self._queue, self._memory = cl.CommandQueue(self._context), Scratch(self._context)
            program = build(self._context, *FILES)
            self._slopes, self._systems = (Kernel(program, name) for name in ("slopes", "systems"))

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
        side = pairs.shape[-1]
        if side % LANES:
            raise ValueError(f"a side of {side} pixels is no multiple of {LANES}")
        if not len(pairs):
            return np.empty((0, mixes.shape[1], side, side), np.float32)
        with device_errors(self.name):
            return self._run(pairs, here, (mixes, middles), blur)

    def systems(
        self, slopes: Numbers, rows: Sequence[Row], known: NDArray[np.float64] | None
    ) -> tuple[NDArray[np.float64], ...]:
        """What N poses' derivatives (N, D, S, S) say of them, the unknowns of their light eliminated.

        ``rows``: of each what ``LightEvidence.details`` tells. ``known`` (N, Q - 4): precision of each positive plane
        that is known from earlier frames, or None. Curvature (N, D, D) at a light that is held; what the light could
        do instead takes of it; as much were nothing known of its paint; and slope (N, D).
        """
        n, d = slopes.shape[:2]
        out = (*(np.empty((n, d, d)) for _ in range(3)), np.empty((n, d)))
        with device_errors(self.name):
            for told in {id(row.told): row.told for row in rows}.values():
                at = [k for k, row in enumerate(rows) if row.told is told]
                few = (slopes, known) if len(at) == n else (slopes[at], None if known is None else known[at])
                for one, part in zip(out, self._eliminate(told, [rows[k] for k in at], *few), strict=True):
                    one[at] = part
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
    ) -> Numbers:
        n, _, drawn, side, _ = pairs.shape
        radii = np.array([max(len(smooth), len(slope)) // 2 for _, smooth, slope in blur], np.int32)
        length = side + 2 * (-(-int(radii.max()) // LANES) * LANES)
        each = (drawn + 5) * side * side + side * length
        items = work_items(self._queue.device, n, 4 * each)
        given = [None if one is None else lent(self._context, np.ascontiguousarray(one)) for one in (pairs, here)]
        result = landing(self._context, (n, numbers[0].shape[1], side, side), zeros=True)
        mixes, middles = (constant(self._context, np.ascontiguousarray(one, np.float32)) for one in numbers)
        weights = constant(self._context, np.array([weight for weight, _, _ in blur], np.float32))
        both = [smooth for _, smooth, _ in blur], [slope for _, _, slope in blur]
        smooth, slope = (
            constant(self._context, np.concatenate([_padded(one, r) for one, r in zip(taps, radii, strict=True)]))
            for taps in both
        )
        counts = (np.int32(n), np.int32(drawn), np.int32(numbers[0].shape[1]))
        sizes = (np.int32(side), np.int32(len(blur)))
        spread = weights, constant(self._context, radii), smooth, slope, np.int32(length)
        tail = result.argument, self._memory.of(4 * each * items), np.uint64(each), zero(self._context)
        self._slopes(self._queue, (items,), (1,), *given, *counts, mixes, middles, *sizes, *spread, *tail)
        landed(self._queue, result)
        return result.values

    def _eliminate(
        self,
        told: Numbers,
        rows: Sequence[Row],
        slopes: Numbers,
        known: NDArray[np.float64] | None,
    ) -> list[NDArray[np.float64]]:
        """``systems`` of poses that were told together."""
        n, d, side, _ = slopes.shape
        unknowns = rows[0].unknowns
        widest = -(-unknowns // EIGHT) * EIGHT
        padded = -(-d // 4) * 4
        each = 2 * widest * (widest + 1) + (2 + LANES) * (unknowns + d + 1) * padded + padded * max(_TILE, side)
        items = work_items(self._queue.device, n, 4 * each)
        own, given = lent(self._context, np.ascontiguousarray(slopes, np.float32)), lent(self._context, told)
        which = constant(self._context, np.array([row.number for row in rows], np.int32))
        out = landings(self._context, (*(3 * [(n, d, d)]), (n, d)), np.float64, zeros=True)
        paint = (None, np.int32(0)) if known is None else (constant(self._context, known), np.int32(known.shape[1]))
        results = [one.argument for one in out]
        head = given, np.uint64(told.shape[1]), which, np.int32(n), np.int32(unknowns), np.int32(side)
        tail = self._memory.of(4 * each * items), np.uint64(each), zero(self._context)
        self._systems(self._queue, (items,), (1,), *head, own, np.int32(d), *paint, *results, *tail)
        landed(self._queue, *out)
        return [one.values for one in out]


def _padded(taps: Numbers, radius: int) -> Numbers:
    """(2 radius + 1,) with zeros beyond both ends."""
    return np.pad(np.asarray(taps, np.float32), radius - len(taps) // 2)


def open_slopes(kind: str = "cpu") -> LightSlopes:
    """On the first usable device of this kind. Raises ``DeviceError`` where OpenCL has none."""
    return LightSlopes(first_device(kind))

"""The light of many drawn poses against one patch of a frame: ``kernels/evidence.cl``, ``evidence_gpu_room.cl``.

Knows pictures and noise, not what they mean: see docs/model.md, section 3. The readable twin is
``service.inference.model.likelihood.fit_light``.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pyopencl as cl
from numpy.typing import NDArray

from gpu.cut import Cut, cut_of
from gpu.device import DeviceReport, first_device, open_device
from gpu.evidence_groups import Asked, EvidenceGroups
from gpu.evidence_terms import LANES, HostInputs, PatchInputs, Terms, inputs_of, patch_of
from gpu.program import (
    Kernel,
    KernelArgument,
    Scratch,
    build,
    constant,
    device_errors,
    landed,
    landings,
    lent,
    work_items,
    zero,
)
from gpu.shaded_reference import EVEN_PLANES

Numbers = NDArray[np.float32]
Window = tuple[slice, slice]  # rows and columns of a patch
FILES = ("lanes.cl", *(f"evidence{part}.cl" for part in ("_shared", "_facets", "_pictures", "_normal", "")))
EIGHT, NEAR, ODD = 8, 704, 5  # as the kernel has them
HERMITE, BUMPS = 12, 9
_PATCHES = 4  # numerical: that are kept: a frame's own, with its stars and without, finely and followed


@dataclass(frozen=True)
class Answers:
    """Of N poses."""

    log_evidence: NDArray[np.float64]  # (N,)
    chi2: NDArray[np.float64]  # (N,)
    coefficients: Numbers  # (N, Q) what ``ShadedBody.combined`` draws the same light with
    values: Numbers  # (N, U) where the unknowns ended, in the order of ``Terms.mean``


@dataclass(frozen=True)
class Row:
    """Of one pose, as the device tells it: ``kernels/evidence.cl`` lays it out."""

    told: Numbers  # (N, size) of all that were told together
    number: int
    unknowns: int  # that a pose of these has at the most


@dataclass(frozen=True)
class Details:
    """Of one pose, for Gauss-Newton."""

    residual: Numbers  # (S, S)
    weight: Numbers  # (S, S) over A
    model: Numbers
    light: Numbers
    window: Window  # beyond it no pose near by changes anything
    columns: Numbers  # (M, rows, columns) in the window
    precision: NDArray[np.float64]  # (M,)
    deviation: NDArray[np.float64]  # (M,)
    normal: NDArray[np.float64]  # (M, M) curvature of the log posterior
    pull: NDArray[np.float64]  # (M,) its slope
    lit: NDArray[np.intp]  # numbers of the positives that show light: the first of the M
    row: Row


class LightEvidence:
    """One OpenCL device. Owned, used and closed by one thread."""

    def __init__(self, report: DeviceReport, together: bool | None = None) -> None:
        self.name = f"opencl:evidence:{report.name}"
        self.kernel_seconds = 0.0  # that the device says it took for the last call; 0 where it is not asked
        self._groups: EvidenceGroups | None = None
        # Patches that were looked at last, and what of them the device was lent.
        self._patches: deque[tuple[PatchInputs, dict[int, cl.Buffer]]] = deque(maxlen=_PATCHES)
        with device_errors(self.name):
            context = cl.Context([open_device(report)])
            if report.kind != "cpu" if together is None else together:
                timed = cl.command_queue_properties.PROFILING_ENABLE
                self._groups = EvidenceGroups(cl.CommandQueue(context, properties=timed))
                return
            self._queue, self._context, self._memory = cl.CommandQueue(context), context, Scratch(context)
            self._kernel = Kernel(build(context, *FILES, options=[f"-DEVEN_PLANES={EVEN_PLANES}"]), "evidence")

    def evidence(
        self,
        planes: Numbers | Cut,
        n_groups: int,
        terms: Terms | Sequence[Terms],
        rounds: int,
        which: Sequence[int] | None = None,
    ) -> Answers:
        """``planes`` (N, Q, S, S): groups, coverage, normals (3), gloss of groups; all are dark where none is covered.
        Of an array (N, Q, rows, columns) the patch's first rows and columns, beyond which all are dark.

        ``terms``: of all poses, or of each its own, which may differ in priors, point spread, discrepancy and
        photons. Each is of the planes that ``which`` says, in order where nothing is said.
        """
        several = terms if isinstance(terms, Sequence) else [terms]
        return _answers(*self._run(planes, n_groups, several, rounds, (), which))

    def details(
        self, planes: Numbers | Cut, n_groups: int, terms: Terms, rounds: int, which: Sequence[int] | None = None
    ) -> tuple[Answers, list[Details]]:
        """The same, and what each pose's curvature is made of."""
        side = len(terms.data)
        planes = cut_of(planes, side)
        n_planes = planes.values.shape[1]
        unknowns, pixels = self._unknowns(n_planes, terms), side * side
        size = LANES + (4 + unknowns) * pixels + unknowns * (unknowns + 4)
        *answers, out = self._run(planes, n_groups, [terms], rounds, (size,), which)
        always = unknowns - (n_planes - EVEN_PLANES)
        return _answers(*answers), [_details(Row(out, k, unknowns), always, side) for k in range(len(out))]

    def close(self) -> None:
        """Wait for the device and give its memory back."""
        if self._groups is not None:
            self._groups.close()
            return
        self._queue.finish()
        self._patches.clear()
        self._memory.close()

    @staticmethod
    def _unknowns(n_planes: int, terms: Terms) -> int:
        return n_planes - EVEN_PLANES + 9 + HERMITE * terms.speckle + 2 * BUMPS * terms.shifts

    def _run(
        self,
        planes: Numbers | Cut,
        n_groups: int,
        several: Sequence[Terms],
        rounds: int,
        details: tuple[int, ...],
        which: Sequence[int] | None = None,
    ) -> list[Numbers]:
        """What answers are made of, and with ``details`` as many numbers more of each pose."""
        numbers, terms = range(len(planes)) if which is None else which, several[0]
        n, side = len(numbers), len(terms.data)
        cut = cut_of(planes, side)
        n_planes = cut.values.shape[1]
        if side % LANES:
            raise ValueError(f"a side of {side} pixels is no multiple of {LANES}")
        unknowns = self._unknowns(n_planes, terms)
        patch, held = self._patch(terms)
        host = inputs_of(several, numbers, patch)
        shapes = [(n, count) for count in (4, n_planes, unknowns, *details)]
        asked = Asked(n_groups, n_planes, side, unknowns, terms.speckle, terms.shifts, rounds)
        with device_errors(self.name):
            if n and self._groups is None:
                return self._by_items(cut, host, held, asked, shapes)
            told = [np.empty(shape, np.float32) for shape in shapes]
            if n and self._groups is not None:
                whole = np.ascontiguousarray(cut.whole(), np.float32)
                self.kernel_seconds = self._groups.weigh(whole, host, asked, told[:3], told[3] if details else None)
        return told

    def _patch(self, terms: Terms) -> tuple[PatchInputs, dict[int, cl.Buffer]]:
        """What is told of a patch, and of its arrays what the device was lent."""
        for patch, held in self._patches:
            if patch.is_of(terms):
                return patch, held
        self._patches.append((patch_of(terms), {}))
        return self._patches[-1]

    def _by_items(
        self, cut: Cut, host: HostInputs, held: dict[int, cl.Buffer], asked: Asked, shapes: Sequence[tuple[int, int]]
    ) -> list[Numbers]:
        """What is told, of these shapes: a work-item takes pose after pose. ``held``: what was lent of the patch."""
        n, length = shapes[0][0], asked.side + 2 * _lanes(host.radius)
        each = _room(asked.unknowns, asked.n_planes, asked.side, length)
        items = work_items(self._queue.device, n, 4 * each)
        given, window = lent(self._context, np.ascontiguousarray(cut.values, np.float32)), cut.window
        patch = host.patch
        for one in () if held else (patch.data, patch.marks, patch.sky, patch.bumps, patch.boxes):
            held[id(one)] = lent(self._context, one)
        arrays = [one if id(one) in held else np.ascontiguousarray(one) for one in host.arrays]
        inputs: list[KernelArgument] = [
            held[id(one)] if id(one) in held else (lent if one.size else constant)(self._context, one) for one in arrays
        ]
        inputs.insert(3, np.int32(host.every))
        inputs.insert(5, np.int32(host.started))
        sizes = (asked.n_groups, asked.side, asked.n_planes, asked.speckle, asked.shifts, asked.rounds)
        numbers = (*sizes, window.top, window.left, window.rows, window.columns)
        told = landings(self._context, shapes)
        results = [one.argument for one in told] + [None] * (4 - len(told))
        head: tuple[KernelArgument, ...] = (
            given,
            np.int32(n),
            *inputs,
            *(np.int32(v) for v in (*numbers, length, host.n_stars)),
            *(np.float32(v) for v in host.scalars),
            *(constant(self._context, one) for one in (host.spreads, host.own)),
        )
        tail = (self._memory.of(4 * each * items), np.uint64(each))
        self._kernel(self._queue, (items,), (1,), *head, *results, *tail, zero(self._context))
        landed(self._queue, *told)
        return [one.values for one in told]


def _answers(out: Numbers, drawn: Numbers, ended: Numbers) -> Answers:
    return Answers(out[:, 0].astype(np.float64), out[:, 1].astype(np.float64), drawn, ended)


def open_evidence(kind: str = "cpu", together: bool | None = None) -> LightEvidence:
    """On the first usable device of this kind. Raises ``DeviceError`` where OpenCL has none.

    ``together``: work-groups share a pose out, where a work-item takes one; None: unless the device is a CPU.
    """
    return LightEvidence(first_device(kind), together)


def _details(whole: Row, always: int, side: int) -> Details:
    """What a row says; ``always``: unknowns that every pose has. The rest is not written."""
    row, unknowns = whole.told[whole.number], whole.unknowns
    count, pixels = int(row[0]), side * side
    maps = row[LANES : LANES + 4 * pixels].reshape(4, side, side)
    rest = row[LANES + 4 * pixels :]
    tail = rest[unknowns * pixels :]
    top, bottom, left, right = (int(v) for v in row[1:5])
    shape = count, bottom - top, right - left
    columns = rest[: count * shape[1] * shape[2]].reshape(shape)
    window = slice(top, bottom), slice(left, right)
    starts = (0, unknowns, 2 * unknowns, unknowns * (unknowns + 2), unknowns * (unknowns + 3))
    lengths = (count, count, count * count, count, count - always)
    parts = [tail[at : at + length].astype(np.float64) for at, length in zip(starts, lengths, strict=True)]
    maps_four = maps[0], maps[1], maps[2], maps[3]
    more = parts[2].reshape(count, count), parts[3], parts[4].astype(np.intp)
    return Details(*maps_four, window, columns, parts[0], parts[1], *more, whole)


def _lanes(count: int) -> int:
    return -(-count // LANES) * LANES


def _room(unknowns: int, n_planes: int, side: int, length: int) -> int:
    """Numbers of one work-item, as ``room_in`` deals them out."""
    slots, width, pixels = unknowns - 1, -(-unknowns // EIGHT) * EIGHT, side * side
    vectors = (
        7 * _lanes(2 * width)
        + 3 * _lanes(unknowns)
        + _lanes(4 * slots)
        + _lanes(slots + 3)
        + _lanes(slots * (side // LANES))
    )
    matrices = _lanes(2 * width * width) + _lanes(2 * slots * slots) + (slots + 1) ** 2 * LANES
    pictures = slots * (pixels + ODD * LANES) + 6 * pixels + side * length
    return vectors + matrices + pictures + 2 * max(NEAR, (slots + 3) * EIGHT) * LANES

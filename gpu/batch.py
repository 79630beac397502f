"""Particles of several frames in one kernel launch: each looks up its own frame's maps.

A particle's score is a sum of whole numbers that depends on its transforms and its maps alone, so it has the same bits
whoever is scored beside it.
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pyopencl as cl
from numpy.typing import NDArray

from gpu.device import DeviceReport
from gpu.errors import ScorerError
from gpu.looping import Transforms
from gpu.mesh import Mesh
from gpu.outline_cpu import CpuOutline, unresolved
from gpu.outline_gpu import GpuOutline
from gpu.outline_kernels import open_kernels
from gpu.program import constant, device_errors

KEPT_SHAPES = 4
Shape = tuple[int, int, int]  # of prefix sums: maps, rows, columns + 1


@dataclass(frozen=True)
class Question:
    """Particles of one frame. ``slot`` names the frame's maps, which ``BatchOutline.put`` has brought."""

    slot: int
    transforms: Transforms  # (N, P, 3, 4), N >= 1


class BatchOutline:
    """An outline scorer of one mesh for many frames at once. Owned, used and closed by one thread.

    ``kernel`` is ``"cpu"`` or ``"gpu"``; by default the device's kind decides.
    """

    def __init__(self, mesh: Mesh, report: DeviceReport, kernel: str | None = None) -> None:
        self.name = f"opencl:outline:{report.name}"
        self.launches = 0
        self._parts = len(mesh.parts)
        with device_errors(self.name):
            kernels = open_kernels(mesh, report, kernel)
            self.queue, self._by_group, self._by_item = kernels.queue, kernels.by_group, kernels.by_item
        self._maps: dict[int, NDArray[np.int32] | None] = {}  # by slot, as they came
        self._sets: OrderedDict[Shape, _Sets] = OrderedDict()

    def take_slot(self) -> int:
        """A number for one asker's maps, until ``drop_slot``."""
        slot = next(n for n in range(len(self._maps) + 1) if n not in self._maps)
        self._maps[slot] = None
        return slot

    def drop_slot(self, slot: int) -> None:
        """Nobody will ask for this slot's maps again."""
        del self._maps[slot]

    def put(self, slot: int, prefix: NDArray[np.int32]) -> None:
        """The maps of a frame, as (K, H, W + 1) prefix sums (``gpu.prefix.fixed_point_prefix``)."""
        self._maps[slot] = prefix
        for sets in self._sets.values():
            sets.loaded.discard(slot)

    def score(self, questions: Sequence[Question]) -> list[NDArray[np.int64]]:
        """(N, K) scores of each question, in units of its maps; one launch for all whose maps are of one shape.

        Raises ``ScorerError`` where memory is short, ``DeviceLostError`` where the device fails.
        """
        answers: dict[int, NDArray[np.int64]] = {}
        shapes = [self._put(one.slot).shape for one in questions]
        with device_errors(self.name):
            for shape in dict.fromkeys(shapes):
                mine = [k for k, of_one in enumerate(shapes) if of_one == shape]
                scores = self._launch(shape, [questions[k] for k in mine])
                ends = np.cumsum([len(questions[k].transforms) for k in mine])[:-1]
                answers.update(zip(mine, np.split(scores, ends), strict=True))
        return [answers[k] for k in range(len(questions))]

    def close(self) -> None:
        """Wait for the device."""
        self.queue.finish()

    def _put(self, slot: int) -> NDArray[np.int32]:
        prefix = self._maps.get(slot)
        if prefix is None:
            raise ScorerError(f"no maps were brought for slot {slot}")
        return prefix

    def _launch(self, shape: Shape, questions: Sequence[Question]) -> NDArray[np.int64]:
        transforms = np.concatenate([one.transforms for one in questions])
        places = np.repeat([one.slot for one in questions], [len(one.transforms) for one in questions])
        sets = self._loaded(shape, {one.slot for one in questions})
        self.launches += 1
        scores = self._run(self._by_item or self._by_group, transforms, places, sets, shape)
        crowded = unresolved(scores)
        if len(crowded):
            scores[crowded] = self._run(self._by_group, transforms[crowded], places[crowded], sets, shape)
        return scores

    def _run(
        self,
        kernel: CpuOutline | GpuOutline,
        transforms: Transforms,
        places: NDArray[np.int64],
        sets: _Sets,
        shape: Shape,
    ) -> NDArray[np.int64]:
        context, (n_maps, height, columns) = self.queue.context, shape
        scores = np.empty((len(transforms), n_maps), np.int64)
        out = cl.Buffer(context, cl.mem_flags.WRITE_ONLY, scores.nbytes)
        where = constant(context, places.astype(np.int32))
        size = height, columns - 1
        kernel.score(constant(context, transforms), len(transforms), sets.buffer, n_maps, size, out, where)
        cl.enqueue_copy(self.queue, scores, out)
        return scores

    def _loaded(self, shape: Shape, slots: set[int]) -> _Sets:
        """The device's maps of a shape, those of ``slots`` among them."""
        sets = self._sets.get(shape)
        if sets is None or sets.room <= max(slots):
            room = 1 << max(slots).bit_length()
            each = 4 * shape[0] * shape[1] * shape[2]
            self._sets.pop(shape, None)
            sets = _Sets(cl.Buffer(self.queue.context, cl.mem_flags.READ_ONLY, room * each), room, each, set())
        self._sets[shape] = sets
        self._sets.move_to_end(shape)
        while len(self._sets) > KEPT_SHAPES:
            self._sets.popitem(last=False)
        for slot in slots - sets.loaded:
            cl.enqueue_copy(self.queue, sets.buffer, self._put(slot), dst_offset=slot * sets.each)
            sets.loaded.add(slot)
        return sets


@dataclass(frozen=True)
class _Sets:
    """Room on the device for the maps of several frames, all of one shape."""

    buffer: cl.Buffer
    room: int  # slots
    each: int  # bytes of a slot
    loaded: set[int]

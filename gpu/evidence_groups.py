"""The evidence of many poses on a GPU: ``kernels/evidence_gpu_room.cl``, which says how. Runs on any device."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pyopencl as cl
from numpy.typing import NDArray

from gpu.budget import SHARE_OF_DEVICE
from gpu.evidence_terms import HostInputs
from gpu.program import KernelArgument, Scratch, build, constant
from gpu.shaded_reference import EVEN_PLANES

Numbers = NDArray[np.float32]
FILES = (
    "evidence_shared.cl",
    "evidence_facets.cl",
    *(f"evidence_gpu{part}.cl" for part in ("_room", "_begin", "_model", "_normal", "")),
)
# numerical: work-items of a group, a power of two, 16 or more: as many as there are blocks of products in a simple case
GROUP = 128
# numerical: in how many parts a pose's products are summed: with them few poses fill a GPU
STRIPS = 8
# numerical: bytes of a matrix that is held in local memory, which GPUs have at the least
LARGEST_MATRIX = 48 << 10
# numerical: bytes of all poses of a launch
LARGEST_LAUNCH = 1 << 30
_PIXELS, _RESIDUAL, _TOLD = 32, 3, 16  # as the kernels have them


@dataclass(frozen=True)
class Asked:
    """Of all poses alike."""

    n_groups: int
    n_planes: int
    side: int
    unknowns: int
    speckle: bool
    shifts: bool
    rounds: int

    @property
    def fours(self) -> int:
        """Pictures of the unknowns and the residual by four: the gain has none, two more share one."""
        return -(-(self.unknowns - 1) // 4)

    @property
    def blocks(self) -> int:
        """Four times four of their products each."""
        return self.fours * (self.fours + 1) // 2

    @property
    def cells(self) -> int:
        """Half a matrix, with a right side."""
        return self.unknowns * (self.unknowns + 3) // 2

    def room(self, n_stars: int) -> int:
        """Numbers of one pose, as ``room_in`` deals them out."""
        pixels, positives = self.side**2, self.n_planes - EVEN_PLANES
        vectors = (*(7 * [2 * self.unknowns]), 4, self.unknowns, n_stars, *(3 * [positives]), _TOLD)
        pictures = ((self.unknowns - 1 - _RESIDUAL) * pixels, *(6 * [pixels]), self.n_planes * pixels)
        return sum(-(-count // 32) * 32 for count in (*vectors, STRIPS * 16 * self.blocks, *pictures))


class EvidenceGroups:
    """Launch after launch of all poses: pixels, tiles of products and matrices are shared out over work-groups."""

    def __init__(self, queue: cl.CommandQueue) -> None:
        """``queue`` takes the time of what it does."""
        self._queue, self._context = queue, queue.context
        self._memory, self._matrices = Scratch(self._context), Scratch(self._context)
        self._group = min(GROUP, queue.device.max_work_group_size)
        self._built: dict[str, dict[str, cl.Kernel]] = {}
        self._kernels = self._with("__local")
        self._done: list[cl.Event] = []
        self._given: list[cl.Buffer | None] = []

    def weigh(
        self, planes: Numbers, host: HostInputs, asked: Asked, told: Sequence[Numbers], details: Numbers | None
    ) -> float:
        """Fill ``told`` and ``details`` as ``kernels/evidence.cl`` does; how many seconds the kernels took."""
        n, each, device = len(told[0]), 4 * asked.room(host.n_stars), self._queue.device
        fits = 8 * asked.cells <= min(LARGEST_MATRIX, device.local_mem_size)
        self._kernels = self._with("__local" if fits else "__global")
        most = min(LARGEST_LAUNCH, int(SHARE_OF_DEVICE * device.global_mem_size), device.max_mem_alloc_size)
        size = min(n, max(1, most // each))
        matrix: KernelArgument | cl.LocalMemory = cl.LocalMemory(8 * asked.cells)
        if not fits:
            matrix = self._matrices.of(8 * asked.cells * size)
        flags = cl.mem_flags.WRITE_ONLY
        results = [cl.Buffer(self._context, flags, a.nbytes) for a in told]
        more = None if details is None else cl.Buffer(self._context, flags, details.nbytes)
        first = self._give(
            planes,
            host,
            asked,
            self._memory.of(each * size),
            (matrix, np.int32(0 if fits else asked.cells)),
            (*results, more),
        )
        self._done = []
        for begin in range(0, n, size):
            for kernel in self._kernels.values():
                kernel.set_arg(first, np.int32(begin))
            self._launch(min(size, n - begin), int(host.spreads[:, 1].max()), host.n_stars, asked)
        for array, result in zip(told, results, strict=True):
            cl.enqueue_copy(self._queue, array, result)
        if details is not None and more is not None:
            cl.enqueue_copy(self._queue, details, more)
        self._given = []
        return 1e-9 * sum(one.profile.end - one.profile.start for one in self._done)

    def close(self) -> None:
        """Give the device's memory back."""
        self._given = []
        self._memory.close()
        self._matrices.close()

    def _with(self, matrix: str) -> dict[str, cl.Kernel]:
        """The kernels, whose matrices lie in this memory: those of many surfaces have no room in a group's own."""
        if matrix not in self._built:
            sizes = {"GROUP": self._group, "STRIPS": STRIPS, "EVEN_PLANES": EVEN_PLANES, "MATRIX": matrix}
            program = build(self._context, *FILES, options=[f"-D{name}={value}" for name, value in sizes.items()])
            own = {"move": cl.Kernel(program, "move")}  # no other kernel has one
            others = self._built.get("__local") or {one.function_name: one for one in program.all_kernels()}
            self._built[matrix] = others | own
        return self._built[matrix]

    def _give(
        self,
        planes: Numbers,
        host: HostInputs,
        asked: Asked,
        memory: cl.Buffer,
        matrix: tuple[KernelArgument | cl.LocalMemory, np.int32],
        results: tuple[cl.Buffer | None, ...],
    ) -> int:
        """Set every kernel's arguments; where among them the number of a launch's first pose is."""
        given = constant(self._context, planes)
        held = [constant(self._context, np.ascontiguousarray(a)) for a in host.arrays]
        offset, mean, precision, start, pieces, ties, data, marks, sky, bumps, weights, radii, taps, boxes = held
        sizes = (asked.n_groups, asked.side, asked.n_planes, asked.speckle, asked.shifts)
        numbers = np.array([*sizes, host.n_stars, host.every, host.started, asked.room(host.n_stars)], np.int32)
        alike = (numbers, np.array(host.scalars, np.float32), host.spreads, host.own)
        common = (*(constant(self._context, a) for a in alike), memory)
        later = np.int32(0)  # what differs from launch to launch
        tile = cl.LocalMemory(16 * _PIXELS * (asked.fours | 1))
        own: dict[str, tuple[KernelArgument | cl.LocalMemory | None, ...]] = {
            "cover": (given, radii),
            "blur_down": (given, radii, taps, later),
            "blur_across": (weights, radii, taps, later),
            "start": (mean, precision, start, pieces, ties, offset, data),
            "light": (),
            "slopes": (),
            "speckle": (later,),
            "model": (data, marks, sky, bumps),
            "stars": (marks, boxes),
            "products": (sky, tile),
            "move": (offset, results[-1], *matrix, later),
            "finish": (marks, results[0]),
            "tell": (mean, precision, pieces, ties, offset, sky, *results[1:]),
        }
        self._given = [*common, *held, *results, given]  # a kernel does not keep what it is told
        for name, arguments in own.items():
            self._kernels[name].set_args(*common, later, *arguments)  # type: ignore[arg-type]  # its stub
        return len(common)

    def _launch(self, n: int, components: int, n_stars: int, asked: Asked) -> None:
        pixels, group = asked.side**2, self._group
        self._go("cover", n, group)
        for component in range(components):
            for name in ("blur_down", "blur_across"):
                self._go(name, n, asked.n_planes * pixels, component)
        self._go("start", n, group)
        for left in range(asked.rounds, -1, -1):
            self._go("light", n, pixels)
            self._go("slopes", n, pixels)
            for order in range(2, 5 if asked.speckle else 2):
                self._go("speckle", n, (order + 1) * pixels, order)
            self._go("model", n, pixels)
            if n_stars:
                self._go("stars", n, n_stars * group)
            self._go("products", n, STRIPS * -(-asked.blocks // group) * group)
            self._go("move", n, group, int(left == 0))
        self._go("finish", n, group)
        self._go("tell", n, group)

    def _go(self, name: str, n: int, items: int, last: int | None = None) -> None:
        """``last``: the kernel's last argument, which differs from launch to launch."""
        kernel = self._kernels[name]
        if last is not None:
            kernel.set_arg(kernel.num_args - 1, np.int32(last))
        self._done.append(cl.enqueue_nd_range_kernel(self._queue, kernel, (items, n), (self._group, 1)))

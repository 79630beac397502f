"""How a launch of ``ShadedBody`` shares its poses out: a work-item for each on a CPU, a work-group on a GPU."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
import pyopencl as cl
from numpy.typing import NDArray

from gpu.budget import group_count
from gpu.cut import Cut, Window
from gpu.lens import NEAREST, NO_LENS, Lens, magnified
from gpu.program import (
    Kernel,
    KernelArgument,
    Landing,
    Scratch,
    build,
    constant,
    landed,
    landing,
    lent,
    work_items,
    zero,
)
from gpu.shaded_faces import LANES
from gpu.shaded_reference import BIAS_TEXELS, DARK, EVEN_PLANES, STEEPEST, Around

Numbers = NDArray[np.float32]
FACES = ("lanes.cl", "shaded_faces.cl", "shaded_light.cl")
# numerical: of a GPU, work-items of a group: so many pieces of faces a round can share
GROUP = 256
# numerical: samples of a tile; with GROUP it takes the 48 KiB of local memory that GPUs have at the least
TILE = 8192
# numerical: groups for each compute unit, more than fit at once, so that none waits for the last
GROUPS_PER_UNIT = 8
# numerical: bytes of pictures that a launch leaves on the device before they are fetched
LARGEST_RESULT = 1 << 30
_ROUND_BYTES = 4 * 15  # of local memory, for each item of a group
_REST_BYTES = 64


@dataclass(frozen=True)
class FacesOnDevice:
    """A body's faces, or some parts' of them."""

    arguments: tuple[KernelArgument, ...]
    n_padded: int


@dataclass(frozen=True)
class Sizes:
    """Of what is drawn: see ``ShadedBody``."""

    side: int
    supersample: int
    shadow_px: int
    n_groups: int  # of paint
    n_shiny: int  # groups of gloss
    gloss: tuple[float, ...] = ()
    lens: Lens = NO_LENS
    around: Around = DARK

    @property
    def shadow_side(self) -> int:
        """Texels along a side of the Sun's view, with a border."""
        return self.shadow_px + 4 if self.shadow_px else 0

    def camera(self) -> tuple[np.float32, ...]:
        """One over the focal length, and the principal point, in samples; and the light from all around."""
        focal, *middle = magnified(self.lens, self.supersample)
        return tuple(np.float32(v) for v in (1 / focal, *(v - 0.5 for v in middle), *self.around))


class Form(Protocol):
    """What both can do. ``given``: transforms (N, P, 3, 4) and unit vectors towards the Sun (N, 3); N > 0."""

    context: cl.Context
    kernel_seconds: float  # that the device says it drew in the last call; 0 where it is not asked

    def draw(
        self,
        faces: FacesOnDevice,
        given: tuple[Numbers, Numbers],
        sizes: Sizes,
        window: Window,
        share: Numbers | None,
        count: int,
    ) -> Cut:
        """(N, count, side, side): every plane, or with ``share`` (Q',) or (N, Q') their sums.

        ``window``: beyond which planes may be left out.
        """
        ...

    def seen(self, faces: FacesOnDevice, views: Numbers, sizes: Sizes) -> NDArray[np.uint8]:
        """(K,) 1 where a face is nearest to some sample of a view, else 0."""
        ...

    def close(self) -> None:
        """Give the device's memory back."""
        ...


def form_on(device: cl.Device, together: bool | None) -> Form:
    """The form for a device, or the one that is asked for."""
    if together is None:
        together = not device.type & cl.device_type.CPU
    return GroupForm(device) if together else ItemForm(device)


def _options() -> list[str]:
    return [
        f"-DBIAS={BIAS_TEXELS}f",
        f"-DSTEEPEST={STEEPEST}f",
        f"-DNEAREST={NEAREST}f",
        f"-DEVEN_PLANES={EVEN_PLANES}",
    ]


class ItemForm:
    """A work-item takes pose after pose, sixteen samples at a time: ``kernels/shaded.cl``."""

    def __init__(self, device: cl.Device) -> None:
        self.kernel_seconds = 0.0
        self._queue = cl.CommandQueue(cl.Context([device]))
        self.context = self._queue.context
        self._memory = Scratch(self.context)
        program = build(self.context, *FACES, "shaded.cl", options=_options())
        kernels = (Kernel(program, name) for name in ("planes", "combined", "mark_seen"))
        self._planes, self._combined, self._mark_seen = kernels

    def draw(
        self,
        faces: FacesOnDevice,
        given: tuple[Numbers, Numbers],
        sizes: Sizes,
        window: Window,
        share: Numbers | None,
        count: int,
    ) -> Cut:
        """See ``Form``."""
        exponents = constant(self.context, np.asarray(sizes.gloss, np.float32))
        if share is None:
            result = landing(self.context, (len(given[0]), count, window.rows, window.columns), zeros=True)
            numbers = (np.int32(v) for v in (window.top, window.left, window.rows, window.columns))
            self._launch(self._planes, faces, given, sizes, (exponents,), result, tuple(numbers))
            return Cut(result.values, window.top, window.left, sizes.side)
        result = landing(self.context, (len(given[0]), count, sizes.side, sizes.side), zeros=True)
        every = share.shape[1] if share.ndim == 2 else 0
        more = (constant(self.context, share), np.int32(every), np.int32(count))
        self._launch(self._combined, faces, given, sizes, (exponents,), result, more)
        return Cut(result.values, 0, 0, sizes.side)

    def seen(self, faces: FacesOnDevice, views: Numbers, sizes: Sizes) -> NDArray[np.uint8]:
        """See ``Form``."""
        result = landing(self.context, (faces.n_padded,), np.uint8, zeros=True)
        self._launch(self._mark_seen, faces, (views,), sizes, (), result, ())
        return result.values

    def close(self) -> None:
        """See ``Form``."""
        self._queue.finish()
        self._memory.close()

    def _launch(
        self,
        kernel: Kernel,
        faces: FacesOnDevice,
        given: tuple[Numbers, ...],
        sizes: Sizes,
        exponents: tuple[cl.Buffer, ...],
        result: Landing,
        more: tuple[KernelArgument, ...],
    ) -> None:
        n, n_gloss, fine = len(given[0]), len(sizes.gloss), sizes.side * sizes.supersample
        stride, shadow_stride = _lanes(fine), _lanes(sizes.shadow_side)
        shadow = sizes.shadow_px, sizes.shadow_side, shadow_stride
        numbers = (sizes.side, sizes.supersample, stride, *shadow, sizes.n_groups, sizes.n_shiny, n_gloss)
        each = (
            fine * stride
            + sizes.shadow_side * shadow_stride
            + (6 + n_gloss) * faces.n_padded
            + (1 + EVEN_PLANES) * stride
        )
        each = -(-(each + 2 * LANES) // 32) * 32
        items = work_items(self._queue.device, n, 4 * each)
        inputs = (lent(self.context, one) for one in given)
        counter = zero(self.context)
        scratch = self._memory.of(4 * each * items)
        head = (*inputs, np.int32(n), *faces.arguments, *(np.int32(v) for v in numbers), *sizes.camera(), *exponents)
        kernel(self._queue, (items,), (1,), *head, result.argument, scratch, np.int32(each), counter, *more)
        landed(self._queue, result)


class GroupForm:
    """A work-group takes pose after pose: ``kernels/shaded_gpu.cl``. Runs on any device, is made for GPUs."""

    def __init__(self, device: cl.Device) -> None:
        self.kernel_seconds = 0.0
        timed = cl.command_queue_properties.PROFILING_ENABLE
        self._queue = cl.CommandQueue(cl.Context([device]), properties=timed)
        self.context = self._queue.context
        self._memory, self._results = Scratch(self.context), Scratch(self.context)
        self._group = min(GROUP, device.max_work_group_size)
        self._tile = min(TILE, (device.local_mem_size - _ROUND_BYTES * self._group - _REST_BYTES) // 4)
        files = (*FACES, "shaded_gpu_light.cl", "shaded_gpu_faces.cl", "shaded_gpu.cl")
        sizes = [f"-DGROUP={self._group}", f"-DTILE={self._tile}"]
        program = build(self.context, *files, options=[*_options(), *sizes])
        self._kernel = Kernel(program, "draw")

    def draw(
        self,
        faces: FacesOnDevice,
        given: tuple[Numbers, Numbers],
        sizes: Sizes,
        window: Window,
        share: Numbers | None,
        count: int,
    ) -> Cut:
        """See ``Form``; nothing is left out."""
        self.kernel_seconds = 0.0
        out = np.empty((len(given[0]), count, sizes.side, sizes.side), np.float32)
        most = min(LARGEST_RESULT, self._queue.device.max_mem_alloc_size)
        n, size = len(out), max(1, most // out[0].nbytes)
        alike = None if share is None or share.ndim == 2 else constant(self.context, share)
        pictures, every = (0, 0) if share is None else (out.shape[1], share.shape[1] if share.ndim == 2 else 0)
        for few in (slice(start, min(start + size, n)) for start in range(0, n, size)):
            own = alike if share is None or alike is not None else constant(self.context, share[few])
            result = self._results.of(out[few].nbytes)
            weights = (own, np.int32(every), np.int32(pictures), None)
            drawn = self._launch(faces, (given[0][few], given[1][few]), sizes, result, weights)
            cl.enqueue_copy(self._queue, out[few], result)
            self.kernel_seconds += 1e-9 * (drawn.profile.end - drawn.profile.start)
        return Cut(out, 0, 0, sizes.side)

    def seen(self, faces: FacesOnDevice, views: Numbers, sizes: Sizes) -> NDArray[np.uint8]:
        """See ``Form``."""
        marks = np.zeros(faces.n_padded, np.uint8)
        suns = np.tile(np.array([0.0, 0.0, -1.0], np.float32), (len(views), 1))
        marked = constant(self.context, marks)
        self._launch(faces, (views, suns), sizes, None, (None, np.int32(0), np.int32(0), marked))
        cl.enqueue_copy(self._queue, marks, marked)
        return marks

    def close(self) -> None:
        """See ``Form``."""
        self._queue.finish()
        self._memory.close()
        self._results.close()

    def _launch(
        self,
        faces: FacesOnDevice,
        given: tuple[Numbers, Numbers],
        sizes: Sizes,
        result: cl.Buffer | None,
        weights: tuple[KernelArgument | None, ...],
    ) -> cl.Event:
        if sizes.supersample**2 > self._tile:
            raise ValueError(f"{sizes.supersample} samples along a pixel cannot be drawn in tiles of {self._tile}")
        device, n = self._queue.device, len(given[0])
        each = (8 + len(sizes.gloss)) * faces.n_padded + sizes.shadow_side**2
        each = -(-each // 32) * 32
        limits = device.global_mem_size, device.max_mem_alloc_size
        groups = min(n, group_count(device.max_compute_units, GROUPS_PER_UNIT, 4 * each, *limits))
        inputs = (constant(self.context, one) for one in given)
        shadow = sizes.shadow_px, sizes.shadow_side
        numbers = (sizes.side, sizes.supersample, *shadow, sizes.n_groups, sizes.n_shiny, len(sizes.gloss))
        exponents = constant(self.context, np.asarray(sizes.gloss, np.float32))
        head = (*inputs, np.int32(n), *faces.arguments, *(np.int32(v) for v in numbers), *sizes.camera(), exponents)
        tail = (result, self._memory.of(4 * each * groups), np.int32(each), zero(self.context), *weights)
        return self._kernel(self._queue, (groups * self._group,), (self._group,), *head, *tail)


def _lanes(count: int) -> int:
    return -(-count // LANES) * LANES

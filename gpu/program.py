"""Kernels from files, buffers from arrays, and a device's errors as ours."""

from __future__ import annotations

import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from importlib import resources
from itertools import accumulate
from math import prod
from typing import Any, TypeAlias

import numpy as np
import pyopencl as cl
from numpy.typing import NDArray

from gpu.errors import DeviceLostError, ScorerError

# NVIDIA's compiler has a word on every kernel (it may be inlined all the same), and pyopencl warns of any word.
warnings.filterwarnings("ignore", category=cl.CompilerWarning)

KernelArgument: TypeAlias = "np.generic | cl.Buffer | cl.SVM[Any]"  # which is generic for its stub alone
_ALIGNED = 64  # numerical: bytes: a line of a CPU's cache
_RESIDENT = 32  # numerical: groups of one work-item that a compute unit of a GPU holds at once


def build(context: cl.Context, *files: str, options: Sequence[str] = ()) -> cl.Program:
    """Build the named files of ``gpu/kernels``, as if they were one."""
    folder = resources.files("gpu").joinpath("kernels")
    source = "\n".join(folder.joinpath(name).read_text() for name in files)
    program: cl.Program = cl.Program(context, source).build(["-w", *_exact_division(context), *options])
    return program


def _exact_division(context: cl.Context) -> list[str]:
    """Round divisions as the reference does, on devices that can: a crossing then falls into the same pixel."""
    exact = cl.device_fp_config.CORRECTLY_ROUNDED_DIVIDE_SQRT
    able = all(device.single_fp_config & exact for device in context.devices)
    return ["-cl-fp32-correctly-rounded-divide-sqrt"] if able else []


class Kernel:
    """A kernel that learns the types of its numbers once: told with every call, they cost more than a launch."""

    def __init__(self, program: cl.Program, name: str) -> None:
        self._kernel = cl.Kernel(program, name)
        self._is_typed = False

    def __call__(
        self,
        queue: cl.CommandQueue,
        items: tuple[int, ...],
        group: tuple[int, ...] | None,
        *arguments: KernelArgument | None,
    ) -> cl.Event:
        """Launch it."""
        if not self._is_typed:
            self._kernel.set_scalar_arg_dtypes(
                [one.dtype if isinstance(one, np.generic) else None for one in arguments]
            )
            self._is_typed = True
        return self._kernel(queue, items, group, *arguments)


def constant(context: cl.Context, values: NDArray[np.generic]) -> cl.Buffer:
    """A device buffer that starts with ``values`` (an empty array gives one element: OpenCL has no empty buffer)."""
    flags = cl.mem_flags.READ_WRITE | cl.mem_flags.COPY_HOST_PTR
    filled = np.ascontiguousarray(values) if values.size else np.zeros(1, values.dtype)
    return cl.Buffer(context, flags, hostbuf=filled)


def lent(context: cl.Context, values: NDArray[np.generic], *, filled: bool = False) -> cl.Buffer:
    """The array's own memory as a buffer: nothing is copied on a CPU. ``filled``: kernels write to it."""
    flags = cl.mem_flags
    access = flags.READ_WRITE if filled else flags.READ_ONLY
    return cl.Buffer(context, access | flags.USE_HOST_PTR, hostbuf=values)


@dataclass(frozen=True)
class Landing:
    """An array that kernels write to, and that the host reads where it lies once they are done: ``landed``."""

    values: NDArray[Any]
    argument: cl.Buffer | cl.SVM[Any]


def landings(
    context: cl.Context, shapes: Sequence[tuple[int, ...]], dtype: type[np.generic] = np.float32, *, zeros: bool = False
) -> list[Landing]:
    """Arrays of these shapes, none of them empty, filled with ``zeros`` or with nothing.

    Where a device shares its memory with the host, as CPUs do, they need no command to come back, and lie in one piece:
    to ask for it takes as long as a short kernel.
    """
    shares = cl.device_svm_capabilities.FINE_GRAIN_BUFFER
    shared = all(device.svm_capabilities & shares for device in context.devices)
    sizes = [prod(shape) for shape in shapes]
    if shared:
        line = _ALIGNED // np.dtype(dtype).itemsize
        starts = [0, *accumulate(-(-size // line) * line for size in sizes)]
        whole = cl.fsvm_empty(context, (starts[-1],), np.dtype(dtype), alignment=_ALIGNED)
        arrays = [whole[at : at + size].reshape(s) for at, size, s in zip(starts, sizes, shapes, strict=False)]
    else:
        arrays = [np.empty(shape, dtype) for shape in shapes]
    for values in arrays if zeros else ():
        values.fill(0)
    return [Landing(one, cl.SVM(one) if shared else lent(context, one, filled=True)) for one in arrays]


def landing(
    context: cl.Context, shape: tuple[int, ...], dtype: type[np.generic] = np.float32, *, zeros: bool = False
) -> Landing:
    """One of ``landings``."""
    return landings(context, [shape], dtype, zeros=zeros)[0]


def landed(queue: cl.CommandQueue, *results: Landing) -> None:
    """Wait until what kernels wrote is there."""
    for one in results:
        if isinstance(one.argument, cl.Buffer):
            shape, dtype = one.values.shape, one.values.dtype
            mapped, _ = cl.enqueue_map_buffer(queue, one.argument, cl.map_flags.READ, 0, shape, dtype)
            mapped.base.release(queue)
    queue.finish()


def zero(context: cl.Context) -> cl.Buffer:
    """The counter from which persistent work-items and work-groups take the next particle."""
    return constant(context, np.zeros(1, np.int32))


def work_items(device: cl.Device, poses: int, size: int) -> int:
    """How many work-items share the poses, each with ``size`` bytes of memory of its own.

    One for each core of a CPU; on a GPU, whose threads wait for memory most of the time, as many as it holds at once.
    """
    if device.type & cl.device_type.CPU:
        most = device.max_compute_units
    else:
        most = min(device.max_compute_units * _RESIDENT, device.max_mem_alloc_size // size)
    return max(min(int(most), poses), 1)


class Scratch:
    """Memory of all work-items together, kept until more is needed."""

    def __init__(self, context: cl.Context) -> None:
        self._context = context
        self._size = 0
        self._held: cl.Buffer | None = None

    def of(self, size: int) -> cl.Buffer:
        """At least ``size`` bytes; what was handed out before may be gone."""
        if self._held is None or self._size < size:
            self._held = None  # given back before more is asked for
            self._size, self._held = size, cl.Buffer(self._context, cl.mem_flags.READ_WRITE, size)
        return self._held

    def close(self) -> None:
        """Give it back."""
        self._size, self._held = 0, None


@contextmanager
def device_errors(name: str) -> Iterator[None]:
    """Raise ``ScorerError`` where memory is short, ``DeviceLostError`` where the device fails."""
    try:
        yield
    except cl.MemoryError as error:
        raise ScorerError(f"{name} has too little memory: {error}") from error
    except cl.Error as error:
        raise DeviceLostError(f"{name} failed: {error}") from error

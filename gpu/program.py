"""Kernels from files, and buffers from arrays."""

from __future__ import annotations

from collections.abc import Sequence
from importlib import resources

import numpy as np
import pyopencl as cl
from numpy.typing import NDArray


def build(context: cl.Context, *files: str, options: Sequence[str] = ()) -> cl.Program:
    """Build the named files of ``gpu/kernels``, as if they were one."""
    folder = resources.files("gpu").joinpath("kernels")
    source = "\n".join(folder.joinpath(name).read_text() for name in files)
    program: cl.Program = cl.Program(context, source).build(["-w", *options])
    return program


def constant(context: cl.Context, values: NDArray[np.generic]) -> cl.Buffer:
    """A device buffer that starts with ``values`` (an empty array gives one element: OpenCL has no empty buffer)."""
    flags = cl.mem_flags.READ_WRITE | cl.mem_flags.COPY_HOST_PTR
    filled = np.ascontiguousarray(values) if values.size else np.zeros(1, values.dtype)
    return cl.Buffer(context, flags, hostbuf=filled)

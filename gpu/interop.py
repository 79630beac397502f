"""How silhouettes get from OpenGL to OpenCL: shared on the GPU, shared in the host's memory, or copied.

A hand-over owns the memory into which a frame buffer is packed, and lends it to OpenCL. It belongs to the thread of
its OpenGL context. Which one is used is decided from what OpenCL and the device say about themselves, never by
trying: PoCL ends the process when it is asked for a shared buffer.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Protocol, cast

import moderngl
import numpy as np
import pyopencl as cl
from numpy.typing import NDArray

from gpu.gl_memory import MappedBuffer

SHARING_EXTENSION = "cl_khr_gl_sharing"


@dataclass(frozen=True)
class HandOverChoice:
    """``gl_sharing``, ``host_shared`` or ``copy``, and why."""

    name: str
    reason: str


def choose_hand_over(
    cl_has_gl: bool, device_kind: str, device_extensions: tuple[str, ...], gl_storage: bool
) -> HandOverChoice:
    """Decide from: pyopencl's ``have_gl()``, the device's kind and extensions, and OpenGL's buffer storage."""
    if cl_has_gl and SHARING_EXTENSION in device_extensions:
        able = f"pyopencl has GL sharing and the device lists {SHARING_EXTENSION}"
        return HandOverChoice("gl_sharing", f"{able}; copy, if it refuses a context of EGL's")
    lacking = f"the device does not list {SHARING_EXTENSION}" if cl_has_gl else "pyopencl is built without GL sharing"
    if device_kind == "cpu" and gl_storage:
        return HandOverChoice("host_shared", f"{lacking}; OpenCL runs on the CPU, and OpenGL can map a buffer for good")
    why = "OpenGL has no buffer storage" if device_kind == "cpu" else "the device does not work in the host's memory"
    return HandOverChoice("copy", f"{lacking}; {why}")


class HandOver(Protocol):
    """Takes ``size`` bytes at most from a frame buffer."""

    @contextmanager
    def receive(self, frame: moderngl.Framebuffer, viewport: tuple[int, int]) -> Iterator[cl.Buffer]:
        """Pack one byte per pixel of the viewport (width, height), and lend it to OpenCL."""

    def release(self) -> None:
        """Give the memory back."""


class CopyHandOver:
    """Read the pixels into the host's memory, and copy them to the device."""

    def __init__(self, queue: cl.CommandQueue, size: int) -> None:
        self._queue = queue
        self._pixels: NDArray[np.uint8] = np.empty(size, np.uint8)
        self._buffer = cl.Buffer(queue.context, cl.mem_flags.READ_ONLY, size)

    @contextmanager
    def receive(self, frame: moderngl.Framebuffer, viewport: tuple[int, int]) -> Iterator[cl.Buffer]:
        """See ``HandOver``."""
        used = self._pixels[: viewport[0] * viewport[1]]
        frame.read_into(used, viewport=viewport, components=1, alignment=1)
        cl.enqueue_copy(self._queue, self._buffer, used)
        yield self._buffer

    def release(self) -> None:
        """Give the memory back."""
        self._buffer.release()


class HostSharedHandOver:
    """A GL buffer mapped for good; OpenCL works on the very same memory."""

    def __init__(self, queue: cl.CommandQueue, gl: moderngl.Context, size: int) -> None:
        self._queue, self._gl = queue, gl
        self._mapped = MappedBuffer(gl, size)
        flags = cl.mem_flags.READ_ONLY | cl.mem_flags.USE_HOST_PTR
        self._buffer = cl.Buffer(queue.context, flags, hostbuf=self._mapped.memory)

    @contextmanager
    def receive(self, frame: moderngl.Framebuffer, viewport: tuple[int, int]) -> Iterator[cl.Buffer]:
        """See ``HandOver``."""
        # While the host (here: OpenGL) writes, OpenCL must have handed the memory out.
        size = (self._mapped.memory.size,)
        region, _ = cl.enqueue_map_buffer(self._queue, self._buffer, cl.map_flags.WRITE, 0, size, np.dtype(np.uint8))
        frame.read_into(self._mapped.buffer, viewport=viewport, components=1, alignment=1)
        self._gl.finish()
        region.base.release(self._queue)
        yield self._buffer

    def release(self) -> None:
        """Give the memory back, OpenCL's hold on it first."""
        self._buffer.release()
        self._mapped.release()


class GlSharingHandOver:
    """A GL buffer that OpenCL acquires: the pixels never leave the GPU."""

    def __init__(self, queue: cl.CommandQueue, gl: moderngl.Context, size: int) -> None:
        self._queue, self._gl = queue, gl
        self._pixels = gl.buffer(reserve=size)
        self._buffer = cl.GLBuffer(queue.context, cl.mem_flags.READ_ONLY, self._pixels.glo)

    @contextmanager
    def receive(self, frame: moderngl.Framebuffer, viewport: tuple[int, int]) -> Iterator[cl.Buffer]:
        """See ``HandOver``."""
        frame.read_into(self._pixels, viewport=viewport, components=1, alignment=1)
        self._gl.finish()
        cl.enqueue_acquire_gl_objects(self._queue, [self._buffer])
        try:
            yield cast(cl.Buffer, self._buffer)
        finally:
            cl.enqueue_release_gl_objects(self._queue, [self._buffer])
            self._queue.finish()

    def release(self) -> None:
        """Give the memory back, OpenCL's hold on it first."""
        self._buffer.release()
        self._pixels.release()

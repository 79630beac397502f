"""A GL buffer mapped into the host's memory for good: moderngl has no call for it, so OpenGL is asked directly."""

from __future__ import annotations

import ctypes
import ctypes.util
from collections.abc import Callable, Collection
from typing import Protocol

import moderngl
import numpy as np
from numpy.typing import NDArray

from gpu.errors import ScorerError

COPY_WRITE_BUFFER = 0x8F37
READ_PERSISTENT_COHERENT = 0x0001 | 0x0040 | 0x0080  # GL_MAP_READ_BIT | GL_MAP_PERSISTENT_BIT | GL_MAP_COHERENT_BIT
CLIENT_STORAGE = 0x0200


class OpenGL(Protocol):
    """A context, or what is known of one."""

    @property
    def version_code(self) -> int:
        """330 for OpenGL 3.3."""

    @property
    def extensions(self) -> Collection[str]:
        """Their names."""


def has_buffer_storage(gl: OpenGL) -> bool:
    """Whether the context can map a buffer for good (OpenGL 4.4 or the extension)."""
    return gl.version_code >= 440 or "GL_ARB_buffer_storage" in gl.extensions


class MappedBuffer:
    """``memory`` (size,) uint8 and ``buffer`` are the same bytes. Belongs to the thread of its context."""

    def __init__(self, gl: moderngl.Context, size: int) -> None:
        name = ctypes.c_uint()
        _gl("glGenBuffers", ctypes.c_int, ctypes.c_void_p)(1, ctypes.byref(name))
        bind = _gl("glBindBuffer", ctypes.c_uint, ctypes.c_uint)
        bind(COPY_WRITE_BUFFER, name)
        store = _gl("glBufferStorage", ctypes.c_uint, ctypes.c_ssize_t, ctypes.c_void_p, ctypes.c_uint)
        store(COPY_WRITE_BUFFER, size, None, READ_PERSISTENT_COHERENT | CLIENT_STORAGE)
        map_range = _gl(
            "glMapBufferRange", ctypes.c_uint, ctypes.c_ssize_t, ctypes.c_ssize_t, ctypes.c_uint, result=ctypes.c_void_p
        )
        address = map_range(COPY_WRITE_BUFFER, 0, size, READ_PERSISTENT_COHERENT)
        bind(COPY_WRITE_BUFFER, 0)
        if not address:
            raise ScorerError(f"OpenGL could not map a buffer of {size} bytes (error {gl.error})")
        pixels = (ctypes.c_uint8 * size).from_address(address)
        self.memory: NDArray[np.uint8] = np.ctypeslib.as_array(pixels)
        self.buffer = gl.external_buffer(name.value, size)
        self._name = name

    def release(self) -> None:
        """Unmap and delete; ``memory`` must not be touched afterwards."""
        _gl("glDeleteBuffers", ctypes.c_int, ctypes.c_void_p)(1, ctypes.byref(self._name))


def current_egl() -> tuple[int, int]:
    """Handles of EGL's current context and of its display."""
    library = _egl()
    for name in ("eglGetCurrentContext", "eglGetCurrentDisplay"):
        library[name].restype = ctypes.c_void_p
    return library.eglGetCurrentContext() or 0, library.eglGetCurrentDisplay() or 0


def _egl() -> ctypes.CDLL:
    return ctypes.CDLL(ctypes.util.find_library("EGL") or "libEGL.so.1")


def _gl(name: str, *arguments: type, result: type | None = None) -> Callable[..., int]:
    """An OpenGL function of the current context, by name."""
    library = _egl()
    library.eglGetProcAddress.restype = ctypes.c_void_p
    address = library.eglGetProcAddress(name.encode())
    if not address:
        raise ScorerError(f"OpenGL has no {name}")
    function: Callable[..., int] = ctypes.CFUNCTYPE(result, *arguments)(address)
    return function

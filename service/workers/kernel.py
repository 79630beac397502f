"""Calls to the Linux kernel that Python has no function for. Each raises ``OSError`` where the kernel refuses."""

from __future__ import annotations

import ctypes
import os
import signal

_LIBC = ctypes.CDLL(None, use_errno=True)
_SET_DEATH_SIGNAL, _SET_DUMPABLE, _SET_NO_NEW_PRIVILEGES = 1, 4, 38  # linux/prctl.h
_CAPABILITY_VERSION = 0x20080522  # linux/capability.h, version 3: two sets of three words


def call(number: int, *arguments: int | bytes | None) -> int:
    """A system call by its number; ``bytes`` are passed by address."""
    passed = [ctypes.c_char_p(a) if isinstance(a, bytes) else ctypes.c_void_p(a) for a in arguments]
    return _checked(_LIBC.syscall(ctypes.c_long(number), *passed))


def die_with(parent: int) -> None:
    """Have this process killed when the thread of process ``parent`` that started it ends, stopped or hung or not."""
    _prctl(_SET_DEATH_SIGNAL, signal.SIGKILL)
    if os.getppid() != parent:  # it went before the kernel was asked
        os._exit(1)


def hide() -> None:
    """Keep this process's memory and handles from other processes of the same user, and leave no core dumps."""
    _prctl(_SET_DUMPABLE, 0)


def allow_no_new_privileges() -> None:
    """No program that this process runs may have more rights than it has. seccomp and Landlock need it."""
    _prctl(_SET_NO_NEW_PRIVILEGES, 1)


def return_memory() -> None:
    """Give back what the allocator keeps of memory that is free, where it is one that can be asked."""
    if hasattr(_LIBC, "malloc_trim"):  # glibc's
        _LIBC.malloc_trim(0)


def drop_capabilities() -> None:
    """Have no more rights than any user, root included."""
    header = (ctypes.c_uint32 * 2)(_CAPABILITY_VERSION, 0)
    _checked(_LIBC.capset(header, (ctypes.c_uint32 * 6)()))


def _prctl(option: int, value: int) -> None:
    _checked(_LIBC.prctl(option, *(ctypes.c_ulong(n) for n in (value, 0, 0, 0))))


def _checked(result: int) -> int:
    if result < 0:
        number = ctypes.get_errno()
        raise OSError(number, os.strerror(number))
    return result

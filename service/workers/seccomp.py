"""The system calls that a decoder may make (seccomp(2)): an allow list, as a program for the kernel's packet filter.

Whatever is not listed is answered "permission denied", as a file would be; a call made for another machine's
architecture ends the process. Numbers are those of linux/asm/unistd.h for x86_64, then for aarch64 (None: it has no
such call).
"""

from __future__ import annotations

import ctypes
import errno
import os
import platform
import struct
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

from service.workers import kernel

_MACHINES = {"x86_64": (0, 0xC000003E, 317), "aarch64": (1, 0xC00000B7, 277)}  # column, AUDIT_ARCH, seccomp itself

_COMPUTING: Mapping[str, tuple[int | None, int | None]] = {
    # memory
    "brk": (12, 214),
    "madvise": (28, 233),
    "mmap": (9, 222),
    "mprotect": (10, 226),
    "mremap": (25, 216),
    "munmap": (11, 215),
    # threads, which FFmpeg starts for some codecs, and their locks (``clone`` is below)
    "exit": (60, 93),
    "futex": (202, 98),
    "gettid": (186, 178),
    "rseq": (334, 293),
    "sched_getaffinity": (204, 123),
    "sched_yield": (24, 124),
    "set_robust_list": (273, 99),
    # time, chance and itself
    "clock_getres": (229, 114),
    "clock_gettime": (228, 113),
    "clock_nanosleep": (230, 115),
    "getpid": (39, 172),
    "getrandom": (318, 278),
    "getrusage": (98, 165),
    "gettimeofday": (96, 169),
    "nanosleep": (35, 101),
    "sysinfo": (99, 179),
    "uname": (63, 160),
    # signals to itself, and its end
    "exit_group": (231, 94),
    "restart_syscall": (219, 128),
    "rt_sigaction": (13, 134),
    "rt_sigprocmask": (14, 135),
    "rt_sigreturn": (15, 139),
    "sigaltstack": (131, 132),
    # handles that it has: the socket to its parent, videos in memory, and files that it may read
    "close": (3, 57),
    "dup": (32, 23),
    "fstat": (5, 80),
    "lseek": (8, 62),
    "memfd_create": (319, 279),
    "pread64": (17, 67),
    "read": (0, 63),
    "readv": (19, 65),
    "recvfrom": (45, 207),
    "write": (1, 64),
    "writev": (20, 66),
}
_FINDING: Mapping[str, tuple[int | None, int | None]] = {  # Python looks for modules; only Landlock says where
    "access": (21, None),
    "faccessat": (269, 48),
    "faccessat2": (439, 439),
    "getcwd": (79, 17),
    "getdents64": (217, 61),
    "lstat": (6, None),
    "newfstatat": (262, 79),
    "readlink": (89, None),
    "readlinkat": (267, 78),
    "stat": (4, None),
}
_CLONE, _CLONE3, _FCNTL, _OPENAT, _PRCTL = (56, 220), (435, 435), (72, 25), (257, 56), (157, 167)
_PRLIMIT, _SENDTO, _TGKILL = (302, 261), (44, 206), (234, 131)

_CLONE_THREAD = 0x10000
_SET_NAME = 15  # of prctl: FFmpeg names its threads
_HARMLESS_FCNTL = (1, 2, 3, 1030)  # F_GETFD, F_SETFD, F_GETFL, F_DUPFD_CLOEXEC: none that has signals sent
_WRITING = os.O_WRONLY | os.O_RDWR | os.O_CREAT | os.O_TRUNC | os.O_APPEND

_LOAD, _AND, _IF_EQUAL, _RETURN = 0x20, 0x54, 0x15, 0x06  # linux/bpf_common.h
_ALLOW, _ERRNO, _KILL = 0x7FFF0000, 0x00050000, 0x80000000  # linux/seccomp.h
_SET_FILTER, _ALL_THREADS = 1, 1
_NUMBER_AT, _MACHINE_AT, _ARGUMENTS_AT = 0, 4, 16  # in struct seccomp_data
Instruction = tuple[int, int, int, int]  # operation, steps if true, steps if false, operand


@dataclass(frozen=True)
class _Word:
    """A condition: these bits of an argument's lower (or upper) half are this value."""

    argument: int
    value: int
    bits: int = 0xFFFFFFFF
    upper: bool = False


def restrict(*, reading: bool) -> None:
    """Hold every thread of this process to the list, for good. ``reading``: files may be opened to be read.

    Raises ``OSError`` where the kernel has no seccomp or this machine is not known.
    """
    machine = platform.machine()
    if machine not in _MACHINES:
        raise OSError(errno.ENOSYS, f"no list of system calls for {machine}")
    code = b"".join(struct.pack("=HBBI", *step) for step in _program(machine, os.getpid(), reading))
    held = ctypes.create_string_buffer(code, len(code))
    described = struct.pack("@HP", len(code) // 8, ctypes.addressof(held))
    if kernel.call(_MACHINES[machine][2], _SET_FILTER, _ALL_THREADS, described):
        raise OSError(errno.EBUSY, "a thread has another filter")


def _program(machine: str, pid: int, reading: bool) -> Iterator[Instruction]:
    column, architecture, _ = _MACHINES[machine]
    yield _LOAD, 0, 0, _MACHINE_AT
    yield _IF_EQUAL, 1, 0, architecture
    yield _RETURN, 0, 0, _KILL
    yield _LOAD, 0, 0, _NUMBER_AT
    for numbers in (*_COMPUTING.values(), *(_FINDING.values() if reading else ())):
        yield from _if(numbers[column], (), _ALLOW)
    yield from _if(_CLONE3[column], (), _ERRNO | errno.ENOSYS)  # its flags cannot be seen; libraries fall back
    for numbers, conditions in _conditional(pid, reading):
        yield from _if(numbers[column], conditions, _ALLOW)
    yield _RETURN, 0, 0, _ERRNO | errno.EACCES


def _conditional(pid: int, reading: bool) -> Iterator[tuple[tuple[int, int], Sequence[_Word]]]:
    yield _CLONE, [_Word(0, _CLONE_THREAD, _CLONE_THREAD)]  # threads, no processes
    yield _TGKILL, [_Word(0, pid)]  # abort()
    yield _PRLIMIT, [_Word(0, 0)]  # its own limits
    yield _PRCTL, [_Word(0, _SET_NAME)]
    yield _SENDTO, [_Word(4, 0), _Word(4, 0, upper=True)]  # to nobody but the other end
    for command in _HARMLESS_FCNTL:
        yield _FCNTL, [_Word(1, command)]
    if reading:
        yield _OPENAT, [_Word(2, 0, _WRITING)]


def _if(number: int | None, conditions: Sequence[_Word], outcome: int) -> Iterator[Instruction]:
    """``outcome`` for a call of this number under these conditions; else on, with the number loaded."""
    if number is None:
        return
    left = 3 * len(conditions) + 1  # steps up to the return, with it
    yield _IF_EQUAL, 0, left, number
    for word in conditions:
        left -= 3
        # Both machines have the lower half first.
        yield _LOAD, 0, 0, _ARGUMENTS_AT + 8 * word.argument + 4 * word.upper
        yield _AND, 0, 0, word.bits
        yield _IF_EQUAL, 0, left, word.value
    yield _RETURN, 0, 0, outcome
    if conditions:
        yield _LOAD, 0, 0, _NUMBER_AT

"""The decode process as it is, taken over by a file: beside decoding it tries what an intruder would."""

import ctypes
import errno
import os
import signal
import socket
import subprocess
import sys
import threading
from collections.abc import Callable
from pathlib import Path

from service.workers import decode_child, landlock
from service.workers.decode_wire import Reply

PTRACE_ATTACH = 16
PARENT = os.getppid()  # asked while it may be
_LIBC = ctypes.CDLL(None, use_errno=True)


def main(descriptor: int, with_landlock: bool = True) -> None:
    """See ``service.workers.decode_child.main``."""
    jobs = decode_child._jobs
    decode_child._jobs = lambda decoder: {**jobs(decoder), "attack": attack}
    if not with_landlock:
        landlock.restrict = no_landlock
    decode_child.main(descriptor)


def no_landlock(_: object) -> None:
    raise OSError(errno.ENOSYS, "none in this kernel")


def attack(body: bytes, name: str, target: str) -> Reply:
    """What became of it: the name of the errno it was refused with, or None."""
    try:
        ATTACKS[name](target)
    except OSError as error:
        return Reply(errno.errorcode[error.errno or errno.EINVAL])
    return Reply(None)


def read_file(path: str) -> None:
    Path(path).read_bytes()


def list_folder(path: str) -> None:
    os.listdir(path)  # noqa: PTH208 -- the call itself is what is tried


def write_file(path: str) -> None:
    Path(path).with_suffix(".mine").write_bytes(b"x")


def change_file(path: str) -> None:
    os.close(os.open(path, os.O_WRONLY))


def remove_file(path: str) -> None:
    Path(path).unlink()


def write_beside_code(_: str) -> None:
    Path(decode_child.__file__).with_suffix(".mine").touch()


def connect_inet(_: str) -> None:
    socket.socket(socket.AF_INET).close()


def connect_unix(_: str) -> None:
    socket.socket(socket.AF_UNIX).close()


def run_program(_: str) -> None:
    subprocess.run(["/bin/true"], check=True)


def become_program(_: str) -> None:
    os.execv("/bin/true", ["true"])


def fork(_: str) -> None:
    if os.fork() == 0:
        os._exit(0)


def trace_parent(_: str) -> None:
    _checked(_LIBC.ptrace(PTRACE_ATTACH, PARENT, None, None))


def open_parents_memory(_: str) -> None:
    os.close(os.open(f"/proc/{PARENT}/mem", os.O_RDONLY))


def read_parents_memory(_: str) -> None:
    here = ctypes.create_string_buffer(8)
    there = ctypes.addressof(here)  # some address: the right to ask is looked at first
    pieces = [(ctypes.c_size_t * 2)(at, 8) for at in (ctypes.addressof(here), there)]
    _checked(_LIBC.process_vm_readv(PARENT, pieces[0], 1, pieces[1], 0, 0))


def signal_parent(_: str) -> None:
    os.kill(PARENT, 0)


def raise_others_limits(_: str) -> None:
    import resource

    resource.prlimit(PARENT, resource.RLIMIT_NOFILE)


def start_thread(_: str) -> None:
    """What FFmpeg does: allowed."""
    thread = threading.Thread(target=list)
    thread.start()
    thread.join()


def stop(_: str) -> None:
    os.kill(os.getpid(), signal.SIGSTOP)


def _checked(result: int) -> None:
    if result < 0:
        raise OSError(ctypes.get_errno(), "refused")


ATTACKS: dict[str, Callable[[str], None]] = {
    f.__name__: f
    for f in (
        *(read_file, list_folder, write_file, change_file, remove_file, write_beside_code, connect_inet, connect_unix),
        *(run_program, become_program, fork, trace_parent, open_parents_memory, read_parents_memory, signal_parent),
        *(raise_others_limits, start_thread),
    )
}

if __name__ == "__main__":  # a parent of a decoder and a worker: says which they are, and waits
    from service.workers.child_process import ChildProcess, Program
    from service.workers.decode_process import DecodeProcess

    decoder, worker = DecodeProcess(), ChildProcess(Program("fake_worker:FakeWorker"))
    worker.wait_ready()
    print(decoder.sandbox, decoder.pid, worker.pid, sep="\n", flush=True)
    sys.stdin.read()

"""A Python process for a worker, started before it is known what it will run. Imports next to nothing itself."""

from __future__ import annotations

import os
import socket
import subprocess
import sys
from multiprocessing.connection import Connection

_START = "import sys; from service.workers.child import main; main(int(sys.argv[1]), int(sys.argv[2]), sys.argv[3])"
_SINGLE = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS")


class Interpreter:
    """Starts at once, without waiting, and imports the module ``ahead``; then it waits for its program.

    It ends with the thread that started it, so with this process, and where nobody holds its channel any more.
    """

    def __init__(self, ahead: str = "") -> None:
        here, there = socket.socketpair()
        with there:  # so that the end of the process is the end of the channel
            self.process = subprocess.Popen(
                [sys.executable, "-c", _START, str(there.fileno()), str(os.getpid()), ahead],
                env=_environment(),
                stdin=subprocess.DEVNULL,
                pass_fds=(there.fileno(),),
            )
        self.channel = Connection(here.detach())

    def close(self) -> None:
        """End it at once and release everything."""
        self.process.kill()
        self.process.wait()
        self.channel.close()


def use_one_blas_thread() -> None:
    """Before NumPy is loaded: matrices here are small, and a sum must not depend on the cores.

    Where all cores are busy, several threads wait for each other a hundred times as long as one computes.
    """
    for name in _SINGLE:
        os.environ.setdefault(name, "1")


def _environment() -> dict[str, str]:
    single = {name: os.environ.get(name, "1") for name in _SINGLE}
    return {**os.environ, **single, "PYTHONPATH": os.pathsep.join(sys.path)}

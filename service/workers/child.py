"""First module of a worker process. Imports next to nothing, so that its parent can start it early."""

from __future__ import annotations

import gc
import os
from multiprocessing import parent_process
from multiprocessing.connection import Connection
from typing import Any

from service.workers.kernel import die_with

_SHARED = ("POCL_MAX_PTHREAD_COUNT", "POCL_CPU_MAX_CU_COUNT", "OPENCV_FOR_THREADS_NUM")
_SINGLE = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS")


def run(channel: Connection, factory: str, arguments: tuple[Any, ...], nice: int, threads: int) -> None:
    """Body of a worker process: see ``service.workers.host``. ``threads``: its share of the cores."""
    parent = parent_process()
    if parent is not None and parent.pid is not None:
        die_with(parent.pid)  # whoever stands still cannot see its parent go
    gc.disable()  # until the worker is built: collections in the middle of the imports find nothing
    limit_threads(threads)
    from service.workers.host import serve

    os.nice(nice)  # the web process answers first, where they share their cores
    serve(channel, factory, arguments)


def limit_threads(threads: int) -> None:
    """Set before NumPy, OpenCV and PoCL are loaded, which would each start a thread for every core.

    BLAS has one, whatever the share: the matrices here are small, and a sum must not depend on the number of cores.
    """
    for name in _SHARED:
        os.environ.setdefault(name, str(threads))
    for name in _SINGLE:
        os.environ.setdefault(name, "1")

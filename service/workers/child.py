"""First module of a worker process. Imports next to nothing, so that its parent can start it early."""

from __future__ import annotations

import gc
import importlib
import os
import pickle
from multiprocessing.connection import Connection

from service.workers.kernel import die_with

_SHARED = ("POCL_MAX_PTHREAD_COUNT", "POCL_CPU_MAX_CU_COUNT", "OPENCV_FOR_THREADS_NUM")


def main(descriptor: int, parent: int, ahead: str) -> None:
    """Body of a worker process: see ``service.workers.host``. What it runs is the first message of the channel.

    ``ahead`` is a module to import until that comes.
    """
    die_with(parent)  # whoever stands still cannot see its parent go
    gc.disable()  # until the worker is built: collections in the middle of the imports find nothing
    channel = Connection(descriptor)
    if ahead:
        importlib.import_module(ahead)
    try:
        factory, arguments, nice, threads = pickle.loads(channel.recv_bytes())
    except EOFError:  # it is not needed after all
        return
    limit_threads(threads)
    from service.workers.host import serve

    os.nice(nice)  # the web process answers first, where they share their cores
    serve(channel, factory, arguments)


def limit_threads(threads: int) -> None:
    """Set before OpenCV and PoCL are first used, which would each start a thread for every core."""
    for name in _SHARED:
        os.environ.setdefault(name, str(threads))

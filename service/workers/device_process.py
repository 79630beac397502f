"""Keeps the process of a ``DeviceOwner``: started beside the workers, started again when it ends."""

from __future__ import annotations

import multiprocessing
import os
import shutil
import signal
import socket
import tempfile
import threading
from multiprocessing import connection, parent_process
from multiprocessing.context import SpawnProcess
from pathlib import Path
from typing import Any

import structlog

log = structlog.get_logger(__name__)
_CONTEXT = multiprocessing.get_context("spawn")
NOT_HERE = 3  # exit status: this machine has no device worth sharing
AGAIN_S = 1.0  # between an end and the next start


class DeviceProcess:
    """The owner's process. A thread waits for its end; workers find it by ``address``.

    The listening socket is ours: a worker that asks while the process is starting waits in its queue.
    """

    def __init__(self, any_kind: bool, nice: int) -> None:
        self.restarts = 0
        self.shared = True  # until the owner finds nothing to share
        self._folder = Path(tempfile.mkdtemp(prefix="skypose-device-"))  # for us alone
        self.address = str(self._folder / "owner")
        self._listener = socket.socket(socket.AF_UNIX)
        self._listener.bind(self.address)
        self._listener.listen(128)
        self._arguments = any_kind, nice
        self._closing = threading.Event()
        self._process: SpawnProcess | None = None
        self._thread = threading.Thread(target=self._keep, name="device-owner", daemon=True)

    def start(self) -> None:
        """Begin to bring the process up, without waiting."""
        if not self._thread.is_alive() and not self._closing.is_set():
            self._thread.start()

    def describe(self) -> dict[str, Any]:
        """For operators."""
        process = self._process
        pid = None if process is None else process.pid
        return {"name": "device", "pid": pid, "ready": pid is not None, "restarts": self.restarts}

    def close(self) -> None:
        """End the process; workers that still ask get no answer."""
        self._closing.set()
        process = self._process
        if process is not None:
            process.kill()
        if self._thread.is_alive():
            self._thread.join()
        self._listener.close()
        shutil.rmtree(self._folder, ignore_errors=True)

    def _keep(self) -> None:
        while not self._closing.is_set():
            process = _CONTEXT.Process(target=run, args=(self._listener, *self._arguments), daemon=True)
            process.start()
            self._process = process
            if self._closing.is_set():  # it came between
                process.kill()
            process.join()
            self._process = None
            if process.exitcode == NOT_HERE:
                self.shared = False
                self._listener.close()  # who asks hears at once
                log.info("workers use devices of their own: there is no GPU to share")
                return
            if not self._closing.is_set():
                self.restarts += 1
                log.warning("device owner lost", status=process.exitcode)
                self._closing.wait(AGAIN_S)


def run(listener: socket.socket, any_kind: bool, nice: int) -> None:
    """Body of the process."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent says when
    signal.signal(signal.SIGTERM, signal.SIG_IGN)
    threading.Thread(target=_end_with_parent, daemon=True).start()
    os.nice(nice)
    from gpu.errors import DeviceError
    from service.workers.device_owner import DeviceOwner, shared_device

    try:
        owner = DeviceOwner(listener, shared_device(any_kind))
    except DeviceError:
        os._exit(NOT_HERE)
    while True:
        owner.turn()


def _end_with_parent() -> None:
    parent = parent_process()
    if parent is not None:
        connection.wait([parent.sentinel])
        os._exit(1)

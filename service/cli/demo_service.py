"""The service as a child process, for the demo and the load benchmark."""

from __future__ import annotations

import socket
import subprocess
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from types import TracebackType

import httpx

_START_LIMIT_S = 60.0
_STOP_LIMIT_S = 15.0
_POLL_S = 0.02
_LOG_LINES = 15


class DemoError(Exception):
    """The demo cannot go on; the message says why and what to do."""


class ServiceProcess:
    """Starts ``skypose serve`` and ends it; a context manager."""

    def __init__(self, host: str, port: int, folder: Path, options: Sequence[str] = ()) -> None:
        """``options`` are those of ``skypose serve`` beside host, port and data directory."""
        self.url = f"http://{host}:{port}"
        self._host, self._port, self._folder, self._options = host, port, folder, options
        self._log = folder / "service.log"
        self._process: subprocess.Popen[bytes] | None = None

    def __enter__(self) -> ServiceProcess:
        _require_free(self._host, self._port)
        command = [sys.executable, "-m", "service", "serve", "--host", self._host, "--port", str(self._port)]
        with self._log.open("wb") as log:
            self._process = subprocess.Popen(
                [*command, "--data", str(self._folder / "data"), *self._options], stdout=log, stderr=subprocess.STDOUT
            )
        try:
            self._wait_until_ready()
        except BaseException:
            self._stop()
            raise
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._stop()

    @property
    def pid(self) -> int:
        """Process id of the web process."""
        assert self._process is not None, "started by entering the context"
        return self._process.pid

    def wait(self) -> None:
        """Until the service ends by itself, or Ctrl-C."""
        assert self._process is not None, "started by entering the context"
        self._process.wait()

    def _wait_until_ready(self) -> None:
        assert self._process is not None, "called by __enter__"
        until = time.monotonic() + _START_LIMIT_S
        with httpx.Client(timeout=2.0) as client:  # one for all: making one takes longer than to ask
            while time.monotonic() < until:
                if self._process.poll() is not None:
                    raise DemoError(f"the service ended while it started:\n{self._last_log_lines()}")
                try:
                    if client.get(f"{self.url}/readyz").status_code == httpx.codes.OK:
                        return
                except httpx.TransportError:
                    pass  # not listening yet: ask again until the limit
                time.sleep(_POLL_S)
        raise DemoError(f"the service was not ready after {_START_LIMIT_S:.0f} s:\n{self._last_log_lines()}")

    def _last_log_lines(self) -> str:
        return "\n".join(self._log.read_text(errors="replace").splitlines()[-_LOG_LINES:])

    def _stop(self) -> None:
        if self._process is None or self._process.poll() is not None:
            return
        self._process.terminate()
        try:
            self._process.wait(_STOP_LIMIT_S)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()


def free_port(host: str) -> int:
    """A port that nothing listens on."""
    with socket.socket() as probe:
        probe.bind((host, 0))
        port: int = probe.getsockname()[1]
        return port


def _require_free(host: str, port: int) -> None:
    with socket.socket() as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind((host, port))
        except OSError as error:
            raise DemoError(
                f"{host}:{port} is taken ({error.strerror}): end what listens there, or choose another --port"
            ) from error

"""A real server in a process of its own, to be killed and started again; and its entry point with a fake worker."""

import os
import signal
import socket
import subprocess
import sys
import time
from http.client import HTTPConnection, HTTPException
from pathlib import Path

import httpx

ROOT = Path(__file__).resolve().parents[2]


class Server:
    """``skypose serve`` on a data directory. ``worker`` names a fake; without it the real tracker runs.

    ``checkout``: another one than this, with a Python of its own.
    """

    def __init__(self, data: Path, worker: str | None = None, checkout: Path | None = None, **settings: object) -> None:
        self.data = data
        self._root = checkout or ROOT
        self._python = sys.executable if checkout is None else str(checkout / ".venv/bin/python")
        self.log = data.parent / f"{data.name}.log"
        self._worker = worker
        self.environment: dict[str, str] = {}  # more of it, for the next start
        self._settings = {f"SKYPOSE_{name.upper()}": str(value) for name, value in settings.items()}
        self._process: subprocess.Popen[bytes] | None = None
        with socket.socket() as probe:
            probe.bind(("127.0.0.1", 0))
            self.port = probe.getsockname()[1]
        self.url = f"http://127.0.0.1:{self.port}"

    def start(self) -> None:
        """Start, and wait until frames can be posted."""
        entry = ["-m", "service", "serve"] if self._worker is None else [str(Path(__file__))]
        paths = os.pathsep.join([str(self._root), str(self._root / "tests")])
        environment = {
            **os.environ,
            **self._settings,
            "PYTHONPATH": paths,
            "SKYPOSE_PORT": str(self.port),
            "SKYPOSE_DATA_DIR": str(self.data),
            "FAKE_WORKER": self._worker or "",
            **self.environment,
        }
        with self.log.open("ab") as log:
            self._process = subprocess.Popen(
                [self._python, *entry], env=environment, cwd=self._root, stdout=log, stderr=log
            )
        deadline = time.monotonic() + 120
        while not self.ready():
            if self._process.poll() is not None or time.monotonic() > deadline:
                raise RuntimeError(f"the server did not start:\n{self.log.read_text()[-3000:]}")
            time.sleep(0.02)  # not a wait for a result: the port is not there yet

    def ready(self) -> bool:
        """Whether frames can be posted."""
        asked = HTTPConnection("127.0.0.1", self.port, timeout=10)  # httpx takes a tenth of a second to make a client
        try:
            asked.request("GET", "/readyz")
            return asked.getresponse().status == 200
        except (OSError, HTTPException):
            return False
        finally:
            asked.close()

    @property
    def pid(self) -> int:
        """Process id of the web process."""
        assert self._process is not None
        return self._process.pid

    def worker_pids(self) -> list[int]:
        """Process ids of the tracking workers."""
        found = httpx.get(f"{self.url}/v1/system", timeout=60).json()["workers"]
        return [worker["pid"] for worker in found if worker["name"].startswith("track") and worker["pid"]]

    def kill(self) -> None:
        """SIGKILL the web process."""
        assert self._process is not None
        self._process.kill()
        self._process.wait()

    def stop(self) -> int:
        """SIGTERM, and wait. Returns the exit status."""
        assert self._process is not None
        if self._process.poll() is None:
            self._process.send_signal(signal.SIGTERM)
        return self._process.wait(60)


def main() -> None:
    """The server with the fake worker."""
    from service.cli.serve import run
    from service.settings import Settings

    run(Settings(), os.environ["FAKE_WORKER"])


if __name__ == "__main__":
    main()

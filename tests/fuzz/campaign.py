"""The long form of the fuzzer.

    python -m tests.fuzz.campaign --files 100000 --fields 50000 --checkpoints 3000 --requests 5000 --frames 6000

Files go to the decode process that the service uses, fields and checkpoints through the application in this process
(fields with a fake worker, and trees of models to what reads them), requests
and WebSocket frames to a real server with the real tracker. Ends with 1 if anything was answered with 500 or more, an
error was met that nobody foresaw, or a process took more memory than its limit.
"""

import argparse
import asyncio
import json
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import httpx
import structlog

sys.path.append(str(Path(__file__).resolve().parents[1] / "e2e"))
from memory import BOUNDS_MB, over_bound, peaks_mb
from server_process import Server

from tests.fuzz import direct, fields, forged, sockets
from tests.fuzz.attack import Attacker


def files(count: int, seed: int) -> dict[str, Any]:
    """Files to the decode process."""
    began = time.monotonic()
    found = direct.run(count, seed)
    return {
        "inputs": found.inputs,
        "answers": dict(found.answers),
        "wrong": [*found.wrong, *(f"unforeseen: {line}" for line in found.tripped)],
        "decoder_deaths": len(found.deaths),
        "slowest_s": round(found.slowest_s, 2),
        "peak_mb": found.peak_mb,
        "over_limit": int(found.peak_mb > BOUNDS_MB["decoder"]),
        "seconds": round(time.monotonic() - began, 1),
    }


def spoilt_fields(count: int, seed: int) -> dict[str, Any]:
    """Bodies and queries to the application, trees to the readers of models."""
    structlog.configure(wrapper_class=structlog.make_filtering_bound_logger(50))  # a line for every call
    found = asyncio.run(fields.run(count, seed))
    structlog.reset_defaults()
    return {"inputs": found.inputs, "statuses": dict(found.statuses), "wrong": found.wrong, "over_limit": 0}


def checkpoints(count: int, seed: int) -> dict[str, Any]:
    """Forged checkpoints to the application."""
    structlog.configure(wrapper_class=structlog.make_filtering_bound_logger(50))  # a line for every call
    found = asyncio.run(forged.run(count, seed))
    structlog.reset_defaults()
    return {
        "inputs": found.inputs,
        "taken_in_and_used": found.taken,
        "statuses": {str(status): n for status, n in sorted(found.statuses.items())},
        "wrong": found.wrong,
        "over_limit": 0,
    }


def requests(count: int, frames: int, seed: int) -> dict[str, Any]:
    """Requests and WebSocket frames to a server."""
    with tempfile.TemporaryDirectory() as folder:
        server = Server(Path(folder) / "data", log_level="error")
        server.start()
        try:
            with httpx.Client(base_url=server.url, timeout=120) as http:
                attacker = Attacker(http, seed)
                outcome = attacker.run(count)
                wrong = [*outcome.wrong, *sockets.attack(http, attacker.session, frames, seed, server.port)]
                peaks = peaks_mb(server.pid)
                answer = http.get(f"/v1/sessions/{attacker.session}")
                wrong += [] if answer.status_code == 200 else [f"the session afterwards: {answer.text}"]
        finally:
            server.stop()
    return {
        "inputs": outcome.requests + frames,
        "websocket_frames": frames,
        "statuses": {str(status): n for status, n in sorted(outcome.statuses.items())},
        "wrong": wrong,
        "peak_mb": peaks,
        "over_limit": len(over_bound(peaks)),
    }


def main() -> None:
    """The command."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--files", type=int, default=100_000)
    parser.add_argument("--fields", type=int, default=50_000)
    parser.add_argument("--checkpoints", type=int, default=3_000)
    parser.add_argument("--requests", type=int, default=5_000)
    parser.add_argument("--frames", type=int, default=6_000)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--json", type=Path)
    given = parser.parse_args()
    parts = {
        "files": files(given.files, given.seed),
        "fields": spoilt_fields(given.fields, given.seed),
        "checkpoints": checkpoints(given.checkpoints, given.seed),
        "requests": requests(given.requests, given.frames, given.seed),
    }
    wrong = sum(len(part["wrong"]) for part in parts.values())
    over = sum(part["over_limit"] for part in parts.values())
    inputs = sum(part["inputs"] for part in parts.values())
    text = json.dumps({"inputs": inputs, "wrong": wrong, "over_limit": over, **parts}, indent=1)
    print(text)
    if given.json:
        given.json.write_text(text + "\n")
    sys.exit(1 if wrong or over else 0)


if __name__ == "__main__":
    main()

"""What a tenant that sends bombs costs another: its frame rate alone, and beside six loops of a small gzip file that
unpacks to a large one, on a real server with the real tracker.

    python tests/e2e/hostile_tenant.py [--seconds 30] [--loops 6] [--format png|fits] [--interval 0]

Prints its figures as JSON and ends with 1 where the other tenant loses more than a fifth of its rate. Alone and beside
take turns, three times each, so that what else the machine does meets both. ``--interval``: seconds between the frames
of the good client; 0 posts as fast as it is answered.
"""

import argparse
import asyncio
import contextlib
import functools
import gzip
import io
import json
import os
import statistics
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import AsyncIterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

sys.path[:0] = [str(Path(__file__).resolve().parents[2]), str(Path(__file__).resolve().parent)]

import cv2  # noqa: E402
import httpx  # noqa: E402
import numpy as np  # noqa: E402
from astropy.io import fits  # noqa: E402
from load import begin  # noqa: E402
from passes import PNG, Pass, box_pass  # noqa: E402
from server_process import Server  # noqa: E402

FITS = {"Content-Type": "image/fits"}
BOMB_MB = 540
LOST_AT_MOST = 0.20
ROUNDS = 3


@dataclass
class Figures:
    """Seconds of each good frame, alone and beside; answers that the loops had."""

    alone: list[float] = field(default_factory=list)
    beside: list[float] = field(default_factory=list)
    alone_per_s: list[float] = field(default_factory=list)
    beside_per_s: list[float] = field(default_factory=list)
    bombs: Counter[int] = field(default_factory=Counter)


def fits_file(image: np.ndarray) -> bytes:
    """An image as FITS."""
    stream = io.BytesIO()
    fits.PrimaryHDU(image).writeto(stream)
    return stream.getvalue()


@functools.cache
def bomb() -> bytes:
    """Half a mebibyte that unpacks to more than a thousand times as much."""
    return gzip.compress(fits_file(np.zeros((64, 64), np.uint8)) + bytes(BOMB_MB << 20), 9)


def given_pass(form: str) -> tuple[Pass, dict[str, str]]:
    """The good client's images, and how they are sent."""
    given = box_pass(32)
    if form == "png":
        return given, PNG
    frames = [fits_file(cv2.imdecode(np.frombuffer(body, np.uint8), cv2.IMREAD_UNCHANGED)) for body in given.frames]
    return Pass(given.mesh, given.background, frames), FITS


async def good(http: httpx.AsyncClient, given: tuple[Pass, dict[str, str]], seconds: float, interval: float) -> Any:
    """Frames of a session of its own, one after the other. Seconds of each, and how many a second there were."""
    images, headers = given
    session, times, n = await begin(http, images), [], 0
    url = f"/v1/sessions/{session}/frames"
    (await http.post(url, content=images.frames[0], headers=headers)).raise_for_status()  # a search of all poses
    started = time.monotonic()
    while time.monotonic() < started + seconds:
        n += 1
        began = time.monotonic()
        answer = await http.post(url, content=images.frames[n % len(images.frames)], headers=headers)
        answer.raise_for_status()
        times.append(time.monotonic() - began)
        await asyncio.sleep(max(0.0, started + n * interval - time.monotonic()))
    return times, len(times) / (time.monotonic() - started)


@contextlib.asynccontextmanager
async def under_attack(http: httpx.AsyncClient, loops: int, figures: Figures) -> AsyncIterator[None]:
    """So many loops, each sending the bomb again as soon as it is answered."""
    session, body = await begin(http, box_pass(1)), bomb()

    async def loop() -> None:
        while True:
            answer = await http.post(f"/v1/sessions/{session}/frames", content=body, headers=FITS)
            figures.bombs[answer.status_code] += 1

    tasks = [asyncio.create_task(loop()) for _ in range(loops)]
    try:
        yield
    finally:
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)


async def measure(server: Server, keys: list[str], given: argparse.Namespace) -> Figures:
    """Alone and beside, in turn."""
    figures = Figures()
    victim, attacker = (
        httpx.AsyncClient(base_url=server.url, timeout=600, headers={"Authorization": f"Bearer {key}"}) for key in keys
    )
    async with victim, attacker:
        images = given_pass(given.format)
        for _ in range(ROUNDS):
            times, rate = await good(victim, images, given.seconds / ROUNDS, given.interval)
            figures.alone += times
            figures.alone_per_s.append(rate)
            async with under_attack(attacker, given.loops, figures):
                times, rate = await good(victim, images, given.seconds / ROUNDS, given.interval)
            figures.beside += times
            figures.beside_per_s.append(rate)
    return figures


def tenants_key(data: Path, tenant: str) -> str:
    """A key of a tenant, made on the command line."""
    command = [
        sys.executable,
        "-m",
        "service",
        "keys",
        "create",
        "--role",
        "operate",
        "--tenant",
        tenant,
        "--name",
        tenant,
    ]
    root = Path(__file__).resolve().parents[2]
    made = subprocess.run([*command, "--data", str(data)], cwd=root, capture_output=True, text=True, check=True)
    return next(word for word in made.stdout.split() if word.startswith("skypose_"))


def main() -> None:
    """The command."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=30.0, help="of each of the two")
    parser.add_argument("--loops", type=int, default=6)
    parser.add_argument("--format", choices=("png", "fits"), default="png")
    parser.add_argument("--interval", type=float, default=0.0)
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        data = Path(folder) / "data"
        keys = [tenants_key(data, tenant) for tenant in ("good", "hostile")]
        server = Server(data, log_level="error", auth="required")
        server.start()
        try:
            figures = asyncio.run(measure(server, keys, given))
        finally:
            server.stop()
    lost = 1.0 - statistics.median(figures.beside_per_s) / statistics.median(figures.alone_per_s)
    seconds = {name: getattr(figures, name) for name in ("alone", "beside")}
    told = {
        "format": given.format,
        **{f"{name}_per_s": [round(rate, 2) for rate in getattr(figures, f"{name}_per_s")] for name in seconds},
        **{f"{name}_p50_max_s": [round(statistics.median(s), 3), round(max(s), 3)] for name, s in seconds.items()},
        "lost": round(lost, 3),
        "bombs": {str(status): count for status, count in sorted(figures.bombs.items())},
        "load": [round(load, 1) for load in os.getloadavg()],
        "met": lost <= LOST_AT_MOST,
    }
    print(json.dumps(told, indent=1))
    sys.exit(0 if told["met"] else 1)


if __name__ == "__main__":
    main()

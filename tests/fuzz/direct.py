"""The decoders under spoilt files, as fast as they go: in the decode process that the service uses."""

import random
import time
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path

from structlog.testing import capture_logs

from service.errors import InputError
from service.workers.decode_process import DecodeProcess
from service.workers.limits import DecodeLimits
from tests.fuzz.mutate import mend_glb, mend_png, mend_urdf, spoil
from tests.fuzz.seeds import Seed, image_seeds, mesh_seeds, video_seeds


@dataclass
class Findings:
    """What came of the inputs."""

    inputs: int = 0
    answers: Counter[str] = field(default_factory=Counter)  # by kind of error, or "decoded"
    tripped: list[str] = field(default_factory=list)  # last lines of traces: errors nobody foresaw
    deaths: list[str] = field(default_factory=list)
    wrong: list[str] = field(default_factory=list)  # answers that are no refusal: there must be none
    slowest_s: float = 0.0
    peak_mb: int = 0


def all_seeds() -> list[Seed]:
    """Every file that is decoded."""
    return [*image_seeds(), *video_seeds(), *mesh_seeds()]


def make_input(number: int, seeds: list[Seed], seed: int) -> tuple[Seed, bytes]:
    """Input ``number``: a good file and its spoilt bytes."""
    dice = random.Random(seed << 32 | number)
    chosen = seeds[number % len(seeds)]
    if chosen.kind == "glb" and dice.random() < 0.6:
        return chosen, mend_glb(dice, chosen.body)
    if chosen.kind == "urdf" and dice.random() < 0.8:
        return chosen, mend_urdf(dice, chosen.body)
    body = spoil(dice, chosen.body, dice.choice(seeds).body)
    if chosen.kind == "image/png" and dice.random() < 0.7:
        body = mend_png(body)
    return chosen, body


def attack(decoder: DecodeProcess, chosen: Seed, body: bytes, found: Findings) -> None:
    """One input through one decoder."""
    losses, began = decoder.losses, time.monotonic()
    with capture_logs() as logs:
        try:
            if chosen.mesh:
                decoder.parts(body, chosen.kind)
            else:
                decoder.count(body, chosen.kind)
                decoder.facts(body, chosen.kind)
                decoder.frames(body, chosen.kind)
            answer = "decoded"
        except InputError as error:
            answer = error.slug
    found.inputs += 1
    found.answers[answer] += 1
    found.slowest_s = max(found.slowest_s, time.monotonic() - began)
    for entry in logs:
        if entry["event"] == "decoder tripped":
            lines = entry["traceback"].strip().splitlines()
            found.tripped.append(f"{chosen.kind}: {lines[-1]} at {lines[-3].strip() if len(lines) > 3 else ''}")
    if decoder.losses > losses:
        found.deaths.append(f"{chosen.kind}: {answer}")


def run(count: int, seed: int, first: int = 0) -> Findings:
    """``count`` inputs, beginning with number ``first``."""
    found, seeds = Findings(), all_seeds()
    decoder = DecodeProcess(DecodeLimits(timeout_s=60.0))
    try:
        for number in range(first, first + count):
            chosen, body = make_input(number, seeds, seed)
            try:
                attack(decoder, chosen, body, found)
            except Exception as error:  # noqa: BLE001 -- this is what is looked for
                found.wrong.append(f"input {number} ({chosen.kind}): {type(error).__name__}: {error}")
            if number % 500 == 0:
                found.peak_mb = max(found.peak_mb, peak_mb(decoder.pid))
        found.peak_mb = max(found.peak_mb, peak_mb(decoder.pid))
    finally:
        decoder.close()
    return found


def peak_mb(pid: int | None) -> int:
    """Most memory that a process ever had, in MiB."""
    if pid is None:
        return 0
    status = Path(f"/proc/{pid}/status").read_text()
    return next(int(line.split()[1]) for line in status.splitlines() if line.startswith("VmHWM")) >> 10

"""Kills of the web process, the tracking worker, both, or the decoder, at random moments of a long pass.

    python tests/e2e/kill_loop.py --kills 1000 [--minutes 30] [--seed 1] [--json FILE]

Afterwards the same frames go through an undisturbed service; the two histories must be equal bit for bit.
"""

import argparse
import contextlib
import os
import random
import signal
import sys
import tempfile
import threading
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

sys.path[:0] = [str(Path(__file__).resolve().parents[2]), str(Path(__file__).resolve().parent)]

import httpx  # noqa: E402
import numpy as np  # noqa: E402
from figures import finish  # noqa: E402
from passes import PNG, begin, box_pass, comparable  # noqa: E402
from server_process import Server  # noqa: E402

VICTIMS = (("web",), ("worker",), ("web", "worker"), ("decoder",))
SMALL = {"filter": {"particles": 100, "seed": 3}}


@dataclass
class Toll:
    """What was killed when, and when frames were answered."""

    kills: Counter[str] = field(default_factory=Counter)
    at: list[tuple[float, str]] = field(default_factory=list)
    answers: list[float] = field(default_factory=list)

    @property
    def count(self) -> int:
        """Processes killed; a decoder counts as none, since it is the worker's own."""
        return sum(count for name, count in self.kills.items() if name != "decoder")

    def recovery_s(self, name: str | None = None) -> list[float]:
        """From each kill (of this victim) to the next answer."""
        answers = np.array(self.answers)
        found = []
        for moment, victim in self.at:
            later = answers[answers > moment]
            if name in (None, victim) and len(later):
                found.append(float(later[0] - moment))
        return found


def put_until_answered(http: httpx.Client, url: str, image: bytes) -> dict[str, Any]:
    """A client that retries: connection errors, 429 and 503 until there is an answer."""
    deadline = time.monotonic() + 120
    while time.monotonic() < deadline:
        try:
            answer = http.put(url, content=image, headers=PNG)
        except httpx.TransportError:
            time.sleep(0.02)
            continue
        if answer.status_code == 200:
            return answer.json()
        if answer.status_code not in (429, 503):
            raise AssertionError(answer.text)
        time.sleep(0.02)
    raise AssertionError("no answer in two minutes")


def strike(target: Server, victims: tuple[str, ...], delay_s: float, toll: Toll) -> None:
    """SIGKILL after a delay; the web process is started again, the others are the service's own business."""
    workers = target.worker_pids() if victims != ("web",) else []
    pids = [child for pid in workers for child in _children(pid)] if "decoder" in victims else workers
    time.sleep(delay_s)
    toll.at.append((time.monotonic(), "+".join(victims)))
    if "worker" in victims or "decoder" in victims:
        for pid in pids:
            with contextlib.suppress(ProcessLookupError):  # it died with the web process before
                os.kill(pid, signal.SIGKILL)
    for name in victims:
        toll.kills[name] += 1
    if "web" in victims:
        target.kill()
        target.start()


def _children(pid: int) -> list[int]:
    with contextlib.suppress(FileNotFoundError):
        return [int(child) for child in Path(f"/proc/{pid}/task/{pid}/children").read_text().split()]
    return []


def pass_through_kills(target: Server, kills: int, until: float, seed: int) -> tuple[list[dict[str, Any]], int, Toll]:
    """The acknowledged answers, the number of frames, and the toll. Checks the stored history against the answers."""
    dice, toll = random.Random(seed), Toll()
    given = box_pass(32)
    with httpx.Client(base_url=target.url, timeout=60) as http:
        session_id = begin(http, given, **SMALL)
        acknowledged: list[dict[str, Any]] = []
        while toll.count < kills and time.monotonic() < until:
            knife = threading.Thread(target=strike, args=(target, dice.choice(VICTIMS), dice.uniform(0, 0.06), toll))
            knife.start()
            while knife.is_alive() or len(toll.answers) == 0 or toll.answers[-1] < toll.at[-1][0]:
                n = len(acknowledged)
                url = f"/v1/sessions/{session_id}/frames/{n}"
                acknowledged.append(comparable(put_until_answered(http, url, given.frames[n % 32])))
                toll.answers.append(time.monotonic())
            knife.join()
            tell(toll, kills, len(acknowledged))
        stored = whole_history(http, session_id)
    return check(acknowledged, stored), len(acknowledged), toll


def tell(toll: Toll, kills: int, frames: int) -> None:
    """A line for whoever waits, after about every twentieth of the kills."""
    if len(toll.at) % max(1, kills // 20) == 0:
        print(f"{toll.count} of {kills} kills, {frames} frames", file=sys.stderr, flush=True)


def check(acknowledged: list[dict[str, Any]], stored: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Nothing acknowledged is missing or there twice."""
    assert [estimate["index"] for estimate in stored] == list(range(len(acknowledged))), "lost or applied twice"
    assert stored == acknowledged, "an answer is not what was stored"
    return stored


def whole_history(http: httpx.Client, session_id: str) -> list[dict[str, Any]]:
    """All estimates, comparable, over all pages."""
    found, url = [], f"/v1/sessions/{session_id}/estimates?limit=500"
    while url is not None:
        page = http.get(url).raise_for_status().json()
        found += [comparable(estimate) for estimate in page["estimates"]]
        url = page["next"]
    return found


def calm_pass(target: Server, count: int) -> list[dict[str, Any]]:
    """The same frames without any kill."""
    given = box_pass(32)
    with httpx.Client(base_url=target.url, timeout=60) as http:
        session_id = begin(http, given, **SMALL)
        for n in range(count):
            put_until_answered(http, f"/v1/sessions/{session_id}/frames/{n}", given.frames[n % 32])
        return whole_history(http, session_id)


def same_undisturbed(folder: Path, stored: list[dict[str, Any]]) -> bool:
    """Whether an undisturbed service answers the same frames with the same history, bit for bit."""
    calm = Server(folder / "calm", log_level="error")
    calm.start()
    try:
        return calm_pass(calm, len(stored)) == stored
    finally:
        calm.stop()


def report(toll: Toll, frames: int, equal: bool) -> dict[str, Any]:
    """The figures."""
    whole = toll.recovery_s()
    by_victim = {}
    for name in sorted({victim for _, victim in toll.at}):
        times = toll.recovery_s(name)
        by_victim[name] = {"kills": len(times), "p50_s": _at(times, 50), "p99_s": _at(times, 99)}
    return {
        "kills": toll.count,
        "killed": dict(toll.kills),
        "frames": frames,
        "lost": 0,
        "applied_twice": 0,
        "replay_bit_equal": equal,
        "kill_to_first_answer_p50_s": _at(whole, 50),
        "kill_to_first_answer_p99_s": _at(whole, 99),
        "kill_to_first_answer_max_s": _at(whole, 100),
        "by_victim": by_victim,
        "load": os.getloadavg()[1],
    }


def _at(times: list[float], percent: float) -> float:
    return round(float(np.percentile(times, percent)), 3)


def run(kills: int, minutes: float, seed: int) -> dict[str, Any]:
    """The whole loop; raises ``AssertionError`` for anything lost, twice or unequal."""
    with tempfile.TemporaryDirectory() as folder:
        target = Server(Path(folder) / "killed", log_level="error")
        target.start()
        try:
            until = time.monotonic() + 60 * minutes
            stored, frames, toll = pass_through_kills(target, kills, until, seed)
        finally:
            target.stop()
        equal = same_undisturbed(Path(folder), stored)
    return report(toll, frames, equal)


def command(run: Callable[[int, float, int], dict[str, Any]], says: str | None, kills: int, minutes: float) -> None:
    """A kill loop as a command; ``kills`` and ``minutes`` are what it does by default."""
    parser = argparse.ArgumentParser(description=says, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--kills", type=int, default=kills)
    parser.add_argument("--minutes", type=float, default=minutes, help="stop after so long, with fewer kills")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--json", type=Path)
    given = parser.parse_args()
    figures = run(given.kills, given.minutes, given.seed)
    finish(figures, figures["replay_bit_equal"], given.json)


if __name__ == "__main__":
    command(run, __doc__, kills=1000, minutes=120.0)

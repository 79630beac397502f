"""Kills of actors, of whole nodes, and of the web process, at random moments of a long pass on a local Ray cluster.

    python tests/e2e/ray_kills.py --kills 200 [--minutes 30] [--seed 1] [--json FILE]

The cluster has a head, which runs nothing, and two nodes of one core. Afterwards the same frames go through an
undisturbed service with worker processes; the two histories must be equal bit for bit. The tracker is the real one.
"""

import random
import sys
import tempfile
import threading
import time
from pathlib import Path
from typing import Any

sys.path[:0] = [str(Path(__file__).resolve().parents[2]), str(Path(__file__).resolve().parent)]

import httpx  # noqa: E402
from kill_loop import (  # noqa: E402
    SMALL,
    Toll,
    check,
    command,
    put_until_answered,
    report,
    same_undisturbed,
    whole_history,
)
from passes import begin, box_pass, comparable  # noqa: E402
from ray_cluster import LocalCluster, busy_actor, kill_actor, node_of, ray_cluster  # noqa: E402
from server_process import Server  # noqa: E402

NODES = 2
VICTIMS = ("actor", "actor", "actor", "node", "web")


def strike(target: Server, cluster: LocalCluster, victim: str, delay_s: float, toll: Toll) -> None:
    """SIGKILL after a delay, to what the session depends on."""
    home = None if victim == "web" else busy_actor(target)
    time.sleep(delay_s)
    node = node_of(cluster, home) if home is not None and victim == "node" else None
    victim = "actor" if victim == "node" and node is None else victim  # its node was killed, but not noticed yet
    toll.at.append((time.monotonic(), victim))
    toll.kills[victim] += 1
    if home is None:
        target.kill()
        target.start()
    elif node is not None:
        cluster.kill_node(node)
    else:
        kill_actor(home)


def pass_through_kills(
    target: Server, cluster: LocalCluster, kills: int, until: float, seed: int
) -> tuple[list[dict[str, Any]], int, Toll]:
    """The stored history, held against the answers; the number of frames; the toll."""
    dice, toll, given = random.Random(seed), Toll(), box_pass(32)
    with httpx.Client(base_url=target.url, timeout=120) as http:
        session_id = begin(http, given, **SMALL)
        acknowledged: list[dict[str, Any]] = []
        while toll.count < kills and time.monotonic() < until:
            plan = target, cluster, dice.choice(VICTIMS), dice.uniform(0, 0.06), toll
            knife = threading.Thread(target=strike, args=plan)
            knife.start()
            while knife.is_alive() or not toll.answers or toll.answers[-1] < toll.at[-1][0]:
                n = len(acknowledged)
                url = f"/v1/sessions/{session_id}/frames/{n}"
                acknowledged.append(comparable(put_until_answered(http, url, given.frames[n % 32])))
                toll.answers.append(time.monotonic())
            knife.join()
            while len(cluster.nodes) < NODES:  # Ray starts nodes in the main thread only
                cluster.add_node()
        stored = whole_history(http, session_id)
    return check(acknowledged, stored), len(acknowledged), toll


def run(kills: int, minutes: float, seed: int) -> dict[str, Any]:
    """The whole loop; raises ``AssertionError`` for anything lost, twice or unequal."""
    with tempfile.TemporaryDirectory() as folder:
        with ray_cluster(NODES) as cluster:
            chosen = {"engine": "ray", "ray_address": cluster.address, "ray_actors": NODES, "log_level": "error"}
            target = Server(Path(folder) / "killed", **chosen)
            target.start()
            try:
                until = time.monotonic() + 60 * minutes
                stored, frames, toll = pass_through_kills(target, cluster, kills, until, seed)
            finally:
                target.stop()
        equal = same_undisturbed(Path(folder), stored)
    return report(toll, frames, equal)


if __name__ == "__main__":
    command(run, __doc__, kills=200, minutes=60.0)

"""Two web processes on one PostgreSQL, and everything that can happen to them while several sessions are tracked.

    python tests/e2e/cluster_loop.py --kills 500 [--minutes 60] [--sessions 4] [--seed 1] [--json FILE]
    python tests/e2e/cluster_loop.py --kills 20 --one-by-one      # web processes only, the next when both are up again

SIGKILL of web processes and workers at random moments (a supervisor starts a web process again at once), a crash of
the database, owners stopped (SIGSTOP) for longer than their lease and continued, sessions moved while in use. Clients
post to either process and retry. Afterwards the same frames go through one undisturbed process; histories must be
equal. A trigger in the database counts frames written under another epoch than the session's: stale writes.
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
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

sys.path[:0] = [str(Path(__file__).resolve().parents[n]) for n in (2, 1)] + [str(Path(__file__).resolve().parent)]

import httpx  # noqa: E402
import numpy as np  # noqa: E402
from cluster_clients import Client, Database, fake_session, moved  # noqa: E402
from figures import finish  # noqa: E402
from kill_loop import whole_history  # noqa: E402
from postgres_server import Postgres  # noqa: E402
from server_process import Server  # noqa: E402

WORKER = "fake_worker:SlowWorker"
STRIKES = ("web", "web", "worker", "worker", "web+worker", "worker+worker")
FENCED = "nothing of the frame is stored"


@dataclass
class Toll:
    """What was done, and how long clients then waited."""

    kills: Counter[str] = field(default_factory=Counter)
    takeovers: list[float] = field(default_factory=list)  # the other process was up
    outages: list[float] = field(default_factory=list)  # it was being started again, or killed too
    pauses: list[float] = field(default_factory=list)
    moves: list[float] = field(default_factory=list)
    restarts: list[float] = field(default_factory=list)


class Cluster:
    """The two web processes, their database and its server."""

    def __init__(self, folder: Path, postgres: Postgres, lease_s: float) -> None:
        self.postgres = postgres
        self.lease_s = lease_s
        self.url = postgres.database()
        given = {"database_url": self.url, "lease_s": lease_s, "log_level": "warning", "log_format": "text"}
        self.webs = [Server(folder / name, worker=WORKER, **given) for name in ("a", "b")]
        self._starting: dict[str, threading.Thread] = {}
        starts = [threading.Thread(target=web.start) for web in self.webs]
        for start in starts:
            start.start()
        for start in starts:
            start.join()
        self.database = Database(self.url)

    def kill(self, web: Server) -> None:
        """SIGKILL, and start it again, in a thread of its own, as a supervisor would."""
        web.kill()
        again = threading.Thread(target=web.start)
        again.start()
        self._starting[web.url] = again

    def up(self, web: Server) -> bool:
        """Whether it is not being started again."""
        return web.url not in self._starting or not self._starting[web.url].is_alive()

    def all_up(self) -> None:
        """Wait until both are."""
        for again in self._starting.values():
            again.join()

    def owner(self, session: str) -> Server | None:
        """The process that has the session."""
        url = self.database.owner_url(session)
        return next((web for web in self.webs if web.url == url), None)

    def fenced(self) -> int:
        """Frames that an owner was kept from writing, by the logs."""
        return sum(web.log.read_text(errors="replace").count(FENCED) for web in self.webs)

    def stop(self) -> None:
        """Stop both."""
        self.all_up()
        for web in self.webs:
            web.stop()


def strike(cluster: Cluster, how: str, clients: list[Client], dice: random.Random, toll: Toll) -> None:
    """Kill, and wait until every session has had an answer since; note how long those of a killed owner waited."""
    up = [web for web in cluster.webs if cluster.up(web)]
    victims = dice.sample(up, len(up))
    owners = {client.session: cluster.owner(client.session) for client in clients}
    pids = {web.url: _workers(web) for web in victims} if "worker" in how else {}
    moment = time.monotonic()
    killed: list[Server] = []
    for name, web in zip(how.split("+"), victims, strict=False):
        if name == "web":
            cluster.kill(web)
            killed.append(web)
        elif pids[web.url]:
            with contextlib.suppress(ProcessLookupError):
                os.kill(dice.choice(pids[web.url]), signal.SIGKILL)
        else:
            continue
        toll.kills[name] += 1
    for client in clients:
        waited = client.answered_after(moment) - moment
        if owners[client.session] in killed:
            (toll.takeovers if len(killed) < len(up) else toll.outages).append(waited)


def _workers(web: Server) -> list[int]:
    try:
        return web.worker_pids()
    except (httpx.HTTPError, KeyError):  # its only worker is just coming up
        return []


def pause(cluster: Cluster, clients: list[Client], toll: Toll) -> None:
    """Stop the owner of the first session until another has taken it, for longer than its lease; then let it go on."""
    cluster.all_up()
    owner = cluster.owner(clients[0].session)
    if owner is None:
        return
    moment = time.monotonic()
    os.kill(owner.pid, signal.SIGSTOP)
    try:
        for client in clients:
            toll.pauses.append(client.answered_after(moment) - moment)
        while cluster.owner(clients[0].session) in (None, owner) or time.monotonic() < moment + 2 * cluster.lease_s:
            time.sleep(0.05)
    finally:
        os.kill(owner.pid, signal.SIGCONT)
    for client in clients:
        client.answered_after(time.monotonic())


def move(cluster: Cluster, client: Client, toll: Toll) -> None:
    """Move a session in use, and note by how much its slowest frame was slower than usual."""
    cluster.all_up()
    client.answered_after(time.monotonic())
    usual = float(np.median(client.latencies(time.monotonic() - 5)))
    moment = moved(cluster.webs[0].url, client.session)
    client.answered_after(time.monotonic())
    client.answered_after(time.monotonic())
    toll.moves.append(max(client.latencies(moment)) - usual)


def restart(cluster: Cluster, clients: list[Client], toll: Toll) -> None:
    """Crash the database server and start it again."""
    moment = time.monotonic()
    cluster.postgres.control("restart", "-m", "immediate")
    toll.restarts += [client.answered_after(moment) - moment for client in clients]


def pass_through(
    cluster: Cluster, clients: list[Client], kills: int, until: float, seed: int, one_by_one: bool
) -> Toll:
    """All of it: a pause and a move now and then, one restart of the database in the middle."""
    dice, toll, rounds = random.Random(seed), Toll(), 0
    every = max(3, min(25, kills // 3))
    while sum(toll.kills.values()) < kills and time.monotonic() < until:
        if one_by_one:
            cluster.all_up()
        strike(cluster, "web" if one_by_one else dice.choice(STRIKES), clients, dice, toll)
        rounds += 1
        if rounds % every == 1:
            pause(cluster, clients, toll)
        if rounds % every == 0 or rounds == 1:
            move(cluster, dice.choice(clients), toll)
        if not toll.restarts and sum(toll.kills.values()) >= kills // 2:
            restart(cluster, clients, toll)
        time.sleep(dice.uniform(0, 0.1))
    return toll


def calm_pass(folder: Path, count: int) -> list[dict[str, Any]]:
    """The same frames through one process on SQLite."""
    calm = Server(folder / "calm", worker="fake_worker:FakeWorker", log_level="error")
    calm.start()
    try:
        client = Client([calm.url], fake_session(calm.url), 0)
        client.post(count)
        client.leave()
        with httpx.Client(base_url=calm.url, timeout=60) as http:
            return whole_history(http, client.session)
    finally:
        calm.stop()


def report(cluster: Cluster, clients: list[Client], toll: Toll, folder: Path) -> dict[str, Any]:
    """The figures: what was stored against what was answered, and against the undisturbed pass."""
    cluster.all_up()
    expected = calm_pass(folder, max(len(client.answers) for client in clients))
    lost = twice = unequal = 0
    with httpx.Client(base_url=cluster.webs[0].url, timeout=60) as http:
        for client in clients:
            stored = whole_history(http, client.session)
            lost += sum(answer not in stored[n : n + 1] for n, answer in enumerate(client.answers))
            twice += len(stored) - len({estimate["index"] for estimate in stored}) + len(stored) - len(client.answers)
            unequal += stored != expected[: len(stored)]
    return {
        "kills": sum(toll.kills.values()),
        "killed": dict(toll.kills),
        "database_restarts": bool(toll.restarts),
        "owners_paused": len(toll.pauses) // len(clients),
        "moves": len(toll.moves),
        "sessions": len(clients),
        "frames": sum(len(client.answers) for client in clients),
        "lost": lost,
        "applied_twice": twice,
        "stale_writes": cluster.database.stale_writes(),
        "writes_fenced_off": cluster.fenced(),
        "replay_equal": unequal == 0,
        "takeover_s": _shares(toll.takeovers),
        "nobody_left_s": _shares(toll.outages),
        "paused_owner_s": _shares(toll.pauses),
        "database_restart_s": _shares(toll.restarts),
        "move_delay_s": _shares(toll.moves),
        "load": os.getloadavg()[1],
    }


def _shares(times: list[float]) -> dict[str, float]:
    return {f"p{p}": round(float(np.percentile(times, p)), 3) for p in (50, 99, 100)} if times else {}


def run(
    kills: int,
    minutes: float,
    n_sessions: int,
    seed: int,
    postgres: Postgres,
    lease_s: float = 2.0,
    one_by_one: bool = False,
) -> dict[str, Any]:
    """The whole loop, on a server that is running."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        cluster = Cluster(folder, postgres, lease_s)
        cluster.database.watch_writes()
        urls = [web.url for web in cluster.webs]
        clients = [Client(urls, fake_session(urls[n % 2]), seed + n) for n in range(n_sessions)]
        try:
            for client in clients:
                client.start()
            toll = pass_through(cluster, clients, kills, time.monotonic() + 60 * minutes, seed, one_by_one)
            for client in clients:
                client.stop()
            return report(cluster, clients, toll, folder)
        finally:
            for client in clients:
                client.leave()
            cluster.stop()


def good(figures: dict[str, Any]) -> bool:
    """Whether nothing was lost, twice, stale or unequal."""
    return figures["replay_equal"] and not any(figures[name] for name in ("lost", "applied_twice", "stale_writes"))


def main() -> None:
    """The command."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--kills", type=int, default=500)
    parser.add_argument("--minutes", type=float, default=120.0, help="stop after so long, with fewer kills")
    parser.add_argument("--sessions", type=int, default=4)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--one-by-one", action="store_true")
    parser.add_argument("--json", type=Path)
    given = parser.parse_args()
    postgres = Postgres(durable=True)
    try:
        figures = run(given.kills, given.minutes, given.sessions, given.seed, postgres, one_by_one=given.one_by_one)
    finally:
        postgres.close()
    finish(figures, good(figures), given.json)


if __name__ == "__main__":
    main()

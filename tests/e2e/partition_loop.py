"""Two web processes on one PostgreSQL, cut off from it, from each other and from clients, with clocks that step.

    python tests/e2e/partition_loop.py --minutes 20 [--sessions 3] [--seed 1] [--json FILE] [--history FILE]

Six wires (``wires``) stand between clients, processes and database: they are cut, stalled both ways or one way, slowed,
lose bytes in the middle, and send calls twice. The processes' clocks (``stepped_clock``) step by seconds to an hour,
forwards and backwards. Clients share sessions and note what they asked and were told; an outside checker
(``histories``) says whether each session's history can have been. Needs PostgreSQL, a C compiler and Go; ends with 2
where they are missing.
"""

import argparse
import os
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path
from typing import Any

sys.path[:0] = [str(Path(__file__).resolve().parents[n]) for n in (2, 1)] + [str(Path(__file__).resolve().parent)]

import httpx  # noqa: E402
import numpy as np  # noqa: E402
from cluster_clients import fake_session  # noqa: E402
from figures import finish  # noqa: E402
from histories import History, MissingError, built_judge, judged  # noqa: E402
from kill_loop import whole_history  # noqa: E402
from partition_clients import Sharing  # noqa: E402
from partition_site import Faults, Site  # noqa: E402
from passes import PNG, comparable  # noqa: E402
from postgres_server import Postgres  # noqa: E402
from server_process import Server  # noqa: E402
from stepped_clock import compiled  # noqa: E402
from wires import Wires  # noqa: E402

SHARERS = 3
ROUND_S = 45.0


def round_of_sessions(site: Site, faults: Faults, history: History, sessions: list[str], until: float) -> list[Sharing]:
    """Faults while clients share the sessions; then a look at every frame, at both processes, in calm."""
    clients = [
        Sharing(site.urls, session, SHARERS * k + m, history, int(time.monotonic_ns()) + SHARERS * k + m)
        for k, session in enumerate(sessions)
        for m in range(SHARERS)
    ]
    try:
        for client in clients:
            client.start()
        while time.monotonic() < until:
            faults.once(clients)
    finally:
        for client in clients:
            client.stop()
        for client in clients:
            client.join()
    for client in clients[::SHARERS]:
        client.look()
    return clients


def replayed_otherwise(site: Site, sessions: list[str], folder: Path) -> int:
    """How many of the sessions an undisturbed process on SQLite answers otherwise, given the same frames."""
    calm = Server(folder / "calm", worker="fake_worker:FakeWorker", log_level="error")
    calm.start()
    otherwise = 0
    try:
        with httpx.Client(base_url=site.webs[0].url, timeout=60) as stored, httpx.Client(timeout=60) as http:
            for session in sessions:
                found = whole_history(stored, session)
                again = f"{calm.url}/v1/sessions/{fake_session(calm.url)}/frames"
                bodies = site.database.bodies(session)
                answers = [http.post(again, content=body, headers=PNG).raise_for_status().json() for body in bodies]
                otherwise += [comparable(answer) for answer in answers] != found
    finally:
        calm.stop()
    return otherwise


def run(
    minutes: float, n_sessions: int, seed: int, postgres: Postgres, tools: tuple[Path, Path], kept: Path | None
) -> dict[str, Any]:
    """The whole loop, on a server that is running. ``tools``: the judge, the clock's library."""
    until = time.monotonic() + 60 * minutes
    with tempfile.TemporaryDirectory() as name:
        folder, wires, history = Path(name), Wires(seed), History()
        site = Site(folder, postgres, wires, tools[1])
        faults, sessions, clients = Faults(site, seed), [], []
        try:
            while time.monotonic() < until:
                new = [fake_session(site.webs[k % 2].url) for k in range(n_sessions)]
                sessions += new
                clients += round_of_sessions(site, faults, history, new, min(until, time.monotonic() + ROUND_S))
            return {
                **_told(clients, faults),
                **judged(tools[0], history.write(kept or folder / "history")),
                "writes_fenced_off": site.said("nothing of the frame is stored"),
                "commits_lost": site.said("commit lost"),
                "stale_writes": site.database.stale_writes(),
                "replayed_otherwise": replayed_otherwise(site, sessions, folder),
            }
        except AssertionError:
            site.tell_logs()
            raise
        finally:
            if kept is not None:
                history.write(kept)
            site.stop()
            wires.close()


def _told(clients: list[Sharing], faults: Faults) -> dict[str, Any]:
    unforeseen = sum((client.unforeseen for client in clients), Counter[str]())
    return {
        "faults": dict(faults.done),
        "frames": sum(client.frames for client in clients),
        "tries": dict(sum((client.tries for client in clients), Counter[str]())),
        "unforeseen": dict(unforeseen),
        "healed_s": {f"p{p}": round(float(np.percentile(faults.healed_s, p)), 2) for p in (50, 99, 100)},
        "load": os.getloadavg()[1],
    }


def good(figures: dict[str, Any]) -> bool:
    """Whether every history can have been and was decided, and nothing was stale, otherwise or unforeseen."""
    bad = ("impossible", "undecided", "stale_writes", "replayed_otherwise", "unforeseen")
    return not any(figures[name] for name in bad)


def main() -> None:
    """The command."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--minutes", type=float, default=20.0)
    parser.add_argument("--sessions", type=int, default=3, help="at a time; three clients share each")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--json", type=Path)
    parser.add_argument("--history", type=Path, help="keep what the clients noted")
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        try:
            tools = built_judge(Path(name)), compiled(Path(name))
        except MissingError as error:
            print(error, file=sys.stderr)
            sys.exit(2)
        postgres = Postgres(durable=True)
        try:
            figures = run(given.minutes, given.sessions, given.seed, postgres, tools, given.history)
        finally:
            postgres.close()
    finish(figures, good(figures), given.json)


if __name__ == "__main__":
    main()

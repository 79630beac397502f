"""Two web processes with wires and clocks of their own, and what can befall those: for ``partition_loop``."""

import random
import sys
import threading
import time
from collections import Counter
from pathlib import Path

from cluster_clients import Database
from partition_clients import Sharing
from postgres_server import Postgres
from server_process import Server
from stepped_clock import Clock
from wires import CALM, DOWN, UP, Weather, Wire, Wires

LEASE_S = 2.0
HEALED_S = 60.0
STEPS = (2.0, 45.0, 600.0, 3600.0)
WEATHERS = {
    "cut": Weather(cut=True),
    "stalled": Weather(stalled=(UP, DOWN)),
    "answers stalled": Weather(stalled=(DOWN,)),
    "calls stalled": Weather(stalled=(UP,)),
    "delayed": Weather(delay_s=0.3),
    "dropped": Weather(drop=0.2),
}
DOUBLED = {"doubled": Weather(doubled_s=0.5)}


class Site:
    """The two processes, their clocks, and the wires: ``database``, ``peers`` and ``clients``, one each per process."""

    def __init__(self, folder: Path, postgres: Postgres, wires: Wires, library: Path) -> None:
        url = postgres.database()
        self.database = Database(url)
        self.clocks = [Clock(folder, name, library) for name in "ab"]
        self.wires: dict[str, list[Wire]] = {"database": [wires.to(postgres.port) for _ in "ab"]}
        self.webs = []
        for name, clock, wire in zip("ab", self.clocks, self.wires["database"], strict=True):
            mine = url.replace(f":{postgres.port}/", f":{wire.port}/")
            given = {"database_url": mine, "lease_s": LEASE_S, "log_level": "warning", "log_format": "text"}
            self.webs.append(Server(folder / name, worker="fake_worker:SlowWorker", **given))
            self.webs[-1].environment |= clock.environment
        for what in ("peers", "clients"):
            self.wires[what] = [wires.to(web.port) for web in self.webs]
        for web, wire in zip(self.webs, self.wires["peers"], strict=True):
            web.environment["SKYPOSE_INSTANCE_URL"] = f"http://127.0.0.1:{wire.port}"
        starts = [threading.Thread(target=web.start) for web in self.webs]
        for start in starts:
            start.start()
        for start in starts:
            start.join()
        self.database.watch_writes()

    @property
    def urls(self) -> list[str]:
        """Where clients reach the processes."""
        return [f"http://127.0.0.1:{wire.port}" for wire in self.wires["clients"]]

    def said(self, words: str) -> int:
        """How often the processes' logs say that."""
        return sum(web.log.read_text(errors="replace").count(words) for web in self.webs)

    def tell_logs(self) -> None:
        """What the processes said last."""
        for web in self.webs:
            print(f"{web.log.name}:\n{web.log.read_text(errors='replace')[-4000:]}", file=sys.stderr)

    def stop(self) -> None:
        """Stop both."""
        for web in self.webs:
            web.stop()


class Faults:
    """What happens, one or two things at a time, and how long it takes until all sessions go on."""

    def __init__(self, site: Site, seed: int) -> None:
        self.done: Counter[str] = Counter()
        self.healed_s: list[float] = []
        self._site = site
        self._dice = random.Random(seed)

    def once(self, clients: list[Sharing]) -> None:
        """Bad weather for a while, then wait until every session has had a frame stored since."""
        dice, wires = self._dice, []
        for _ in range(dice.choice((1, 1, 2))):
            wires += self._break()
        if dice.random() < 0.5:
            self._step_clock()
        time.sleep(dice.uniform(0.1, 3 * LEASE_S if dice.random() < 0.4 else 1.0))
        for wire in wires:
            wire.set(CALM, cut_first=dice.random() < 0.5)
        moment = time.monotonic()
        self._wait_for_all(clients, moment)
        self.healed_s.append(time.monotonic() - moment)

    def _break(self) -> list[Wire]:
        dice = self._dice
        where = dice.choice(("database", "database", "peers", "clients"))
        name, weather = dice.choice(list((WEATHERS if where == "database" else WEATHERS | DOUBLED).items()))
        wires = self._site.wires[where]
        struck = wires if dice.random() < 0.25 else [dice.choice(wires)]
        for wire in struck:
            wire.set(weather, cut_first=name == "doubled")
        self.done[f"{where} {name}"] += 1
        return struck

    def _step_clock(self) -> None:
        step = self._dice.choice((0.0, *STEPS, *(-s for s in STEPS)))
        self._dice.choice(self._site.clocks).step(step)
        self.done["clock stepped"] += 1

    def _wait_for_all(self, clients: list[Sharing], moment: float) -> None:
        """Until each session has had a frame acknowledged since: at any of its clients."""
        for session in {client.session for client in clients}:
            its = [client for client in clients if client.session == session]
            while max(client.stored_at for client in its) <= moment:
                if time.monotonic() > moment + HEALED_S:
                    raise AssertionError(f"nothing stored {HEALED_S:.0f} s after {self.done}")
                time.sleep(0.02)

"""What time a process takes it to be: the database's, by answers that came soon."""

import asyncio
from types import SimpleNamespace

import pytest

from service.sessions import cluster as module
from service.sessions.cluster import Cluster
from service.store.instances import Instance

pytestmark = pytest.mark.anyio


class Clock:
    """A database that tells the time, and takes ``took_s`` for it."""

    def __init__(self) -> None:
        self.mono = self.took_s = 0.0
        self.ahead = 1000.0
        self.told = asyncio.Event()

    async def write(self, query, *given):
        self.mono += self.took_s / 2
        now = self.mono + self.ahead
        self.mono += self.took_s / 2
        self.told.set()
        return now

    def listen(self, heard, resumed):
        pass


async def test_the_database_tells_the_time_and_late_answers_do_not(monkeypatch):
    database = Clock()
    monkeypatch.setattr(module, "time", SimpleNamespace(monotonic=lambda: database.mono))
    cluster = Cluster(database, Instance("a", "http://a"), 1e-3, lambda _: None, lambda: None)
    database.took_s = 20.0
    await cluster.start()
    assert cluster.now() == database.mono + 1000.0  # the first is all there is
    for took_s, ahead, known in ((9.0, 1500.0, 1000.0), (2.0, 1200.0, 1200.0)):
        database.took_s, database.ahead = took_s, ahead
        database.told.clear()
        await database.told.wait()
        await asyncio.sleep(0)
        assert cluster.now() == database.mono + known
    await cluster.stop()

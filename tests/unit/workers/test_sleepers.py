"""Workers that sleep until jobs wait for each other, and again when they have rested."""

import asyncio

import pytest
from test_process import FACTORY_OF_AWKWARD

from service.errors import WorkerFailedError
from service.workers.child_process import Program
from service.workers.pool import ProcessTransport

pytestmark = pytest.mark.anyio


async def test_a_worker_that_sleeps_wakes_when_jobs_wait_and_sleeps_again():
    transport, names = ProcessTransport(Program(FACTORY_OF_AWKWARD), 2, 60.0, awake=1), []
    long_enough = transport._sleepers._rest_s
    try:
        await transport.start()
        for _ in range(3):  # one after the other none has to wait
            await transport.call("a", "overlay", "pid")
        assert [process["name"] for process in transport.processes()] == ["track-0", "side"]
        pids: set[int] = set()
        while len(pids) < 2:
            pids |= set(await asyncio.gather(*(transport.call(key, "overlay", "pid") for key in "abcd")))
        transport._sleepers._rest_s = 0.0
        while names != ["track-0", "side"]:  # its last job has ended
            for key in "abcd":
                await transport.call(key, "overlay", "pid")
            names = [process["name"] for process in transport.processes()]
            awake = transport._by_name["track-1"].ready
        assert transport.ready and not awake and transport.restarts == 0
        transport._sleepers._rest_s = long_enough
        while len(pids) < 3:  # and again, as another process
            pids |= set(await asyncio.gather(*(transport.call(key, "overlay", "pid") for key in "abcd")))
    finally:
        await transport.close()


async def test_a_worker_that_wakes_prepares_before_it_takes_jobs():
    transport, prepared = ProcessTransport(Program(FACTORY_OF_AWKWARD), 2, 60.0, awake=1), []

    async def prepare(run):
        prepared.append(await run("overlay", "pid"))
        assert transport._placement.workers == ("track-0",)
        return ["m"]

    transport.on_wake(prepare)
    try:
        await transport.start()
        pids: set[int] = set()
        while len(pids) < 2:
            pids |= set(await asyncio.gather(*(transport.call(key, "overlay", "pid") for key in "abcd")))
        assert prepared == [transport._by_name["track-1"].pid] and set(prepared) < pids
        assert transport._placement._places["track-1"].models == {"m": None}
    finally:
        await transport.close()


async def test_a_worker_that_cannot_wake_holds_up_nothing(monkeypatch):
    transport = ProcessTransport(Program(FACTORY_OF_AWKWARD), 2, 60.0, awake=1)
    tried = asyncio.Event()

    async def start() -> None:
        tried.set()
        raise WorkerFailedError("no memory")

    monkeypatch.setattr(transport._by_name["track-1"], "start", start)
    try:
        await transport.start()
        pids = await asyncio.gather(*(transport.call(key, "overlay", "pid") for key in "abcd"))
        assert tried.is_set() and len(set(pids)) == 1
        assert [process["name"] for process in transport.processes()] == ["track-0", "side"]
    finally:
        await transport.close()

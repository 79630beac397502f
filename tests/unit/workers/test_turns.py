"""Work beside the tracking: a tenant waits for others' work in hand, not for all that they have asked for."""

import asyncio
import time
from functools import partial

import pytest

from service.errors import TooLargeError, WorkerFailedError
from service.workers.base import ModelJob
from service.workers.engine import Engine
from service.workers.turns import KEPT, MOST_DEBT_S, Turns

pytestmark = pytest.mark.anyio


class Clock:
    def __init__(self, monkeypatch):
        self.now = 0.0
        monkeypatch.setattr(time, "monotonic", lambda: self.now)


async def _settled():
    for _ in range(5):
        await asyncio.sleep(0)


async def test_who_asks_for_much_is_passed_by_who_asks_for_little(monkeypatch):
    clock, turns, order = Clock(monkeypatch), Turns(lambda: 1), []
    all_wait = asyncio.Event()

    async def work(name: str, seconds: float) -> None:
        order.append(name)
        await all_wait.wait()
        clock.now += seconds

    jobs = [asyncio.create_task(turns.run("greedy", partial(work, f"g{n}", 100.0))) for n in range(4)]
    jobs += [asyncio.create_task(turns.run("modest", partial(work, f"m{n}", 1.0))) for n in range(3)]
    await _settled()
    all_wait.set()
    await asyncio.gather(*jobs)
    assert order == ["g0", "m0", "m1", "m2", "g1", "g2", "g3"]


async def test_what_was_had_counts_though_the_next_is_asked_for_later(monkeypatch):
    clock, turns = Clock(monkeypatch), Turns(lambda: 1)
    order: list[str] = []
    go = asyncio.Event()

    async def long() -> None:
        clock.now += 100.0

    async def work(name: str) -> None:
        order.append(name)

    await turns.run("greedy", long)
    held = asyncio.create_task(turns.run("third", go.wait))
    await _settled()
    jobs = [asyncio.create_task(turns.run(name, partial(work, name))) for name in ("greedy", "modest")]
    await _settled()
    go.set()
    await asyncio.gather(held, *jobs)
    assert order == ["modest", "greedy"]


async def test_who_leaves_while_waiting_holds_nobody_up():
    turns, go = Turns(lambda: 1), asyncio.Event()
    done: list[str] = []

    async def work(name: str) -> None:
        done.append(name)

    for given in (False, True):  # the second time its turn has come, and it leaves before it takes it
        go.clear()
        holder = asyncio.create_task(turns.run("first", go.wait))
        await _settled()
        leaver, stayer = (asyncio.create_task(turns.run(n, partial(work, n))) for n in ("leaver", "stayer"))
        await _settled()
        if not given:
            leaver.cancel()
        go.set()
        while given and not turns_given(turns, "leaver"):
            await asyncio.sleep(0)
        leaver.cancel()
        await asyncio.gather(holder, stayer)
    await turns.run("last", partial(work, "last"))
    assert done == ["stayer", "stayer", "last"]


def turns_given(turns: Turns, name: str) -> bool:
    return name not in turns._waiting


async def test_who_leaves_during_the_work_keeps_the_turn_until_it_is_over():
    turns, go, order = Turns(lambda: 1), asyncio.Event(), []

    async def work(name: str) -> None:
        if name == "leaver":
            await go.wait()
        order.append(name)

    leaver = asyncio.create_task(turns.run("leaver", partial(work, "leaver")))
    await _settled()
    other = asyncio.create_task(turns.run("other", partial(work, "other")))
    leaver.cancel()
    await _settled()
    assert (order, leaver.cancelled()) == ([], True)
    go.set()
    await other
    assert order == ["leaver", "other"]


async def test_places_are_kept_and_nothing_is_remembered_of_the_idle():
    turns, most, now = Turns(lambda: 2), 0, 0

    async def work() -> None:
        nonlocal most, now
        now += 1
        most = max(most, now)
        await asyncio.sleep(0)
        now -= 1

    await asyncio.gather(*(turns.run(f"t{k % 3}", work) for k in range(12)))
    assert (most, now, turns._waiting, turns._taken) == (2, 0, {}, 0)
    for k in range(KEPT + 50):
        await turns.run(f"once{k}", work)
    assert len(turns._ends) == KEPT


async def test_who_had_much_long_ago_is_not_last_for_ever(monkeypatch):
    clock, turns = Clock(monkeypatch), Turns(lambda: 1)

    async def work() -> None:
        clock.now += 1e6

    await turns.run("greedy", work)
    assert turns._ends["greedy"] == MOST_DEBT_S


async def test_a_model_that_takes_too_long_is_the_models_fault():
    class Slow:
        places = 1

        def on_wake(self, prepare):
            pass

        async def call(self, key, method, job):
            raise WorkerFailedError("no answer", limit=3.0, setting="SKYPOSE_WORKER_TIMEOUT_S")

    with pytest.raises(TooLargeError) as refusal:
        await Engine(Slow()).prepare_model("t", ModelJob(b"", "glb"))
    assert refusal.value.facts == {"limit": 3.0, "setting": "SKYPOSE_WORKER_TIMEOUT_S"}

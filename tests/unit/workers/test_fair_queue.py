"""Whose turn it is, played through in made-up time; and the same as something to wait for."""

import asyncio
import heapq
import math
from collections import Counter
from dataclasses import dataclass, field

import pytest

from service.errors import ImageError
from service.workers import fair_queue
from service.workers.fair_queue import ABOUT_S, KNOWN_TENANTS, FairOrder, FairQueue

LONG_S = 600.0


@dataclass
class Client:
    """Sends its next job ``pause_s`` after the answer, or every ``period_s`` where that is later."""

    tenant: str
    job_s: float
    pause_s: float = 0.01
    period_s: float = 0.0
    wasted: bool = False
    sent_s: list[float] = field(default_factory=list)


def played(*clients: Client, seconds: float = LONG_S) -> tuple[Counter[str], Counter[str]]:
    """Jobs and seconds that each tenant has had."""
    order, waiting, jobs, had = FairOrder(), {}, Counter(), Counter()
    events = [(0.0, k, "come", client) for k, client in enumerate(clients)]  # all at once, in this order
    number, busy = len(events), False
    while (event := heapq.heappop(events))[0] < seconds:
        now, _, what, client = event
        if what == "come":
            client.sent_s.append(now)
            waiting.setdefault(client.tenant, []).append(client)
            order.come(client.tenant, now)
        elif what == "end":
            busy = False
            order.end(client.tenant, now, wasted=client.wasted)
            jobs[client.tenant] += 1
            had[client.tenant] += client.job_s
            then = max(now + client.pause_s, client.sent_s[-1] + client.period_s)
            heapq.heappush(events, (then, number := number + 1, "come", client))
        if not busy:
            name, again = order.begin(now)
            if name is not None:
                busy, first = True, waiting[name].pop(0)
                heapq.heappush(events, (now + first.job_s, number := number + 1, "end", first))
            elif again < math.inf:
                heapq.heappush(events, (max(again, now), number := number + 1, "look", client))
    return jobs, had


def hostile(job_s: float, wasted: bool = True) -> list[Client]:
    return [Client("hostile", job_s, wasted=wasted) for _ in range(6)]


@pytest.mark.parametrize("job_s", [0.1, 0.8, 4.0])
@pytest.mark.parametrize(
    "victim", [Client("good", 0.06), Client("good", 0.06, period_s=0.5)], ids=["fast", "2 a second"]
)
def test_six_loops_of_bombs_cost_another_tenant_less_than_a_fifth(victim, job_s):
    alone, _ = played(Client("good", victim.job_s, victim.pause_s, victim.period_s))
    beside, _ = played(Client("good", victim.job_s, victim.pause_s, victim.period_s), *hostile(job_s))
    assert beside["good"] >= 0.8 * alone["good"]
    assert beside["hostile"] > 0


def test_the_longest_waste_leaves_more_than_half_of_the_time():
    _, had = played(Client("good", 0.06), *hostile(20.0))
    assert had["good"] > 0.75 * (LONG_S - had["hostile"])
    assert 0 < had["hostile"] < 0.5 * LONG_S


def test_long_jobs_that_are_right_get_half_of_the_time_and_no_more():
    _, had = played(Client("good", 0.06), *hostile(0.5, wasted=False))
    assert had["good"] == pytest.approx(had["hostile"], rel=0.25)


def test_tenants_are_equal_however_many_sessions_they_have():
    _, had = played(Client("one", 0.05), *(Client("many", 0.05) for _ in range(9)))
    assert had["one"] == pytest.approx(had["many"], rel=0.1)
    assert had["one"] + had["many"] > 0.9 * LONG_S


def test_who_is_alone_has_all_of_the_time():
    _, had = played(*hostile(3.0))
    assert had["hostile"] >= LONG_S - 2 * 3.0


def test_a_slow_client_holds_nobody_up():
    _, had = played(Client("slow", 0.06, period_s=5.0), *hostile(0.5, wasted=False))
    assert sum(had.values()) > 0.98 * LONG_S


def test_who_is_about_at_another_queue_counts():
    seen: dict[str, float] = {}
    order = FairOrder(seen)
    seen["good"] = 0.0
    order.come("hostile", 0.0)
    order.begin(0.0)
    order.end("hostile", 1.0, wasted=True)
    order.come("hostile", 1.0)
    assert order.begin(1.0) == (None, 7.0)
    del seen["good"]
    assert order.begin(1.0) == ("hostile", math.inf)


def test_time_away_is_not_saved_up():
    order = FairOrder()
    for now in range(1000):  # one tenant alone for long
        order.come("here", now)
        order.begin(now)
        order.end("here", now + 1, wasted=False)
    order.come("away", 1000.0)
    order.begin(1000.0)
    order.end("away", 1001.0, wasted=False)
    order.come("away", 1001.0)
    order.come("here", 1001.0)
    assert order.begin(1001.0)[0] == "here"


def test_tenants_that_are_gone_are_forgotten():
    order = FairOrder()
    for n in range(KNOWN_TENANTS + 1):
        now = n + ABOUT_S
        order.come(str(n), now)
        order.begin(now)
        order.end(str(n), now, wasted=False)
    assert len(order._tenants) <= ABOUT_S


async def ready() -> None:
    """What does the jobs is up."""


@pytest.mark.anyio
async def test_jobs_of_a_tenant_keep_their_order_and_one_runs_at_a_time():
    queue, seen, running = FairQueue(), [], 0

    async def job(n: int) -> int:
        nonlocal running
        running += 1
        await asyncio.sleep(0)
        assert running == 1
        running -= 1
        seen.append(n)
        return n

    assert await asyncio.gather(*(queue.run("a", ready, lambda n=n: job(n)) for n in range(5))) == [0, 1, 2, 3, 4]
    assert seen == [0, 1, 2, 3, 4]


@pytest.mark.anyio
async def test_a_waste_is_told_and_makes_others_first(monkeypatch):
    queue, turns, now = FairQueue(), [], 0.0
    monkeypatch.setattr(fair_queue.time, "monotonic", lambda: now)

    async def job(name: str, seconds: float, refused: bool = False) -> None:
        nonlocal now
        now += seconds
        turns.append(name)
        if refused:
            raise ImageError("a bomb")

    await queue.run("good", ready, lambda: job("good", 0.1))
    with pytest.raises(ImageError):
        await queue.run("bad", ready, lambda: job("bad", 2.0, refused=True))
    again = asyncio.create_task(queue.run("bad", ready, lambda: job("bad", 2.0)))
    await asyncio.sleep(0)
    for _ in range(5):
        await queue.run("good", ready, lambda: job("good", 2.0))
    assert turns == ["good", "bad", *["good"] * 5]
    now += 2.0
    queue._next()  # as its timer would
    await again


@pytest.mark.anyio
async def test_what_has_to_come_up_first_is_no_cost_of_the_job(monkeypatch):
    queue, turns, now = FairQueue(), [], 0.0
    monkeypatch.setattr(fair_queue.time, "monotonic", lambda: now)

    async def start() -> None:
        nonlocal now
        now += 100.0

    async def job(name: str) -> None:
        turns.append(name)
        raise ImageError("broken")

    for name in ("other", "unlucky", "unlucky"):
        with pytest.raises(ImageError):
            await queue.run(name, start, lambda name=name: job(name))
    assert turns == ["other", "unlucky", "unlucky"]


@pytest.mark.anyio
async def test_who_gives_up_leaves_the_queue_and_a_job_that_began_keeps_its_turn():
    queue, gate, turns = FairQueue(), asyncio.Event(), []

    async def job(name: str) -> None:
        turns.append(name)
        await gate.wait()

    first, second, third = [asyncio.create_task(queue.run(n, ready, lambda n=n: job(n))) for n in ("a", "b", "c")]
    while not turns:
        await asyncio.sleep(0)
    for task in (first, second):
        task.cancel()
    assert all(
        isinstance(e, asyncio.CancelledError) for e in await asyncio.gather(first, second, return_exceptions=True)
    )
    assert turns == ["a"]
    gate.set()
    await third
    assert turns == ["a", "c"]

"""More and more sessions until answers come late, then between the last two numbers."""

from __future__ import annotations

from collections.abc import Awaitable, Callable, Sequence
from dataclasses import dataclass
from functools import partial

from service.bench.load.clients import Client, Target, send, warm
from service.bench.load.cost import Meter, cost_per_frame
from service.bench.load.plan import LoadPlan, LoadRow

Hear = Callable[[LoadRow], None]
_APART = 27  # frames from one search of a settled track to the next: not all at once
_FINE = 8  # the capacity is known to one part in so many


@dataclass(frozen=True)
class Service:
    """What is measured, and how it calls itself in the rows."""

    target: Target
    meter: Meter
    engine: str
    workers: int


class Fleet:
    """Sessions of one number of particles. They stay from one measurement to the next: a first frame is no load.

    Each is a frame further on than the one before, so that their frames that take longest do not come all at once.
    """

    def __init__(self, target: Target, particles: int, warm_frames: int) -> None:
        self.particles = particles
        self._target, self._warm_frames = target, warm_frames
        self._clients: list[Client] = []

    async def grow(self, n: int) -> Sequence[Client]:
        """The first ``n`` of them; those that are missing begin now."""
        while len(self._clients) < n:
            client = Client(await self._target.begin(self.particles, len(self._clients)))
            await warm(self._target, client, self._warm_frames + len(self._clients) % _APART)
            self._clients.append(client)
        return self._clients[:n]


async def climb(measure: Callable[[int], Awaitable[LoadRow]], most_sessions: int) -> list[LoadRow]:
    """Rows in the order of measuring: sessions doubled while the service holds, then halving the gap."""
    rows: list[LoadRow] = []
    held, broken = 0, most_sessions + 1
    while held < most_sessions and (broken > most_sessions or broken - held > max(1, held / _FINE)):
        n = min(max(2 * held, 1), most_sessions) if broken > most_sessions else (held + broken) // 2
        row = await measure(n)
        rows.append(row)
        held, broken = (n, broken) if row.held else (held, n)
    return rows


async def measure_service(service: Service, plan: LoadPlan, hear: Hear) -> list[LoadRow]:
    """All rows of one service: each number of particles with each frame rate."""
    rows: list[LoadRow] = []
    for particles in plan.particles:
        fleet = Fleet(service.target, particles, plan.warm_frames)
        for rate_hz in plan.rates_hz:
            rows += await climb(partial(_measure, service, plan, fleet, rate_hz, hear), plan.most_sessions)
    return rows


async def _measure(service: Service, plan: LoadPlan, fleet: Fleet, rate_hz: float, hear: Hear, n: int) -> LoadRow:
    clients = await fleet.grow(n)
    before = service.meter.read()
    tally = await send(service.target, clients, rate_hz, plan.seconds)
    used = service.meter.read() - before
    p99_ms = tally.percentile_ms(99)
    row = LoadRow(
        engine=service.engine,
        workers=service.workers,
        particles=fleet.particles,
        rate_hz=rate_hz,
        sessions=n,
        frames_per_s=tally.frames_per_s,
        p50_ms=tally.percentile_ms(50),
        p99_ms=p99_ms,
        late=tally.late,
        refused=tally.refused,
        held=not tally.late and not tally.refused and p99_ms < plan.bound_ms,
        cost=cost_per_frame(used, tally),
    )
    hear(row)
    return row


def capacities(rows: Sequence[LoadRow]) -> list[LoadRow]:
    """Of each engine, workers, particles and rate: the row with the most sessions that held."""
    best: dict[tuple[str, int, int, float], LoadRow] = {}
    for row in rows:
        key = (row.engine, row.workers, row.particles, row.rate_hz)
        if row.held and (key not in best or row.sessions > best[key].sessions):
            best[key] = row
    return list(best.values())

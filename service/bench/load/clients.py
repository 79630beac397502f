"""Clients as telescopes are: a frame whenever the shutter closes, whether or not the last answer is there.

A frame's time counts from the moment it was due. A client that waits for a slow answer before it takes its next
frame, and then starts the clock, would hide the wait of every frame behind it (coordinated omission).
"""

from __future__ import annotations

import asyncio
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np


@dataclass(frozen=True)
class Answer:
    """What came back for one frame. HTTP heads and bodies count."""

    taken: bool  # False: refused for now (429, 503)
    sent_bytes: int
    received_bytes: int


class Target(Protocol):
    """Whatever takes frames."""

    async def begin(self, particles: int, seed: int) -> str:
        """A new session that is ready for its first frame; its name."""
        ...

    async def frame(self, session: str, index: int) -> Answer:
        """Send frame ``index``. Raises ``LoadError`` for an answer that is neither good nor a refusal."""
        ...


@dataclass
class Client:
    """One session and the number of its next frame."""

    session: str
    next_index: int = 0


@dataclass
class Tally:
    """What all clients saw in one measurement."""

    seconds: list[float] = field(default_factory=list)  # of each frame that was taken, from when it was due
    late: int = 0
    refused: int = 0
    sent_bytes: int = 0
    received_bytes: int = 0
    elapsed_s: float = 0.0

    def percentile_ms(self, share: float) -> float:
        """Of the answers' times; infinite where there is none."""
        return float(np.percentile(self.seconds, share)) * 1e3 if self.seconds else float("inf")

    @property
    def frames_per_s(self) -> float:
        """Answered frames over the time until the last answer."""
        return len(self.seconds) / self.elapsed_s if self.elapsed_s else 0.0


async def warm(target: Target, client: Client, frames: int) -> None:
    """The first frames of a session, as fast as they are answered; not counted."""
    while client.next_index < frames:
        if (await target.frame(client.session, client.next_index)).taken:
            client.next_index += 1


async def send(target: Target, clients: Sequence[Client], rate_hz: float, seconds: float) -> Tally:
    """Every client's frames at ``rate_hz`` for so long, the clients spread evenly over the interval."""
    loop = asyncio.get_running_loop()
    tally, start = Tally(), loop.time()
    firsts = [start + k / (rate_hz * len(clients)) for k in range(len(clients))]
    tasks = [
        asyncio.create_task(_follow(target, client, tally, first, start + seconds, 1 / rate_hz))
        for client, first in zip(clients, firsts, strict=True)
    ]
    try:
        await asyncio.gather(*tasks)
    finally:  # one client's failure ends the others
        for task in tasks:
            task.cancel()
    tally.elapsed_s = max(loop.time() - start, seconds)
    return tally


async def _follow(target: Target, client: Client, tally: Tally, first: float, end: float, interval_s: float) -> None:
    loop = asyncio.get_running_loop()
    n_due = max(0, int(np.ceil((end - first) / interval_s - 1e-9)))
    for n in range(n_due):
        due = first + n * interval_s
        await asyncio.sleep(max(0.0, due - loop.time()))
        if loop.time() >= end:
            tally.late += n_due - n
            return
        answer = await target.frame(client.session, client.next_index)
        tally.sent_bytes += answer.sent_bytes
        tally.received_bytes += answer.received_bytes
        if answer.taken:
            client.next_index += 1
            tally.seconds.append(loop.time() - due)
        else:
            tally.refused += 1

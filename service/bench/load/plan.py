"""What is asked of a load benchmark, and what one of its measurements tells."""

from __future__ import annotations

from dataclasses import dataclass


class LoadError(RuntimeError):
    """The service answers what no load explains; the message says what."""


@dataclass(frozen=True)
class LoadPlan:
    """Sessions x frame rate x particles, and when it is too much."""

    particles: tuple[int, ...] = (1000,)
    rates_hz: tuple[float, ...] = (2.0,)  # frames per second that each session is sent
    bound_ms: float = 500.0  # the 99th percentile must stay below it
    seconds: float = 10.0  # of each measurement
    most_sessions: int = 256
    warm_frames: int = 14  # of each session, before it counts: three or four of them search the whole space

    def __post_init__(self) -> None:
        if min(self.particles, default=0) < 1 or min(self.rates_hz, default=0.0) <= 0:
            raise ValueError("a load has particles and frames per second")


@dataclass(frozen=True)
class Cost:
    """Per answered frame; None where it cannot be seen, as on another machine."""

    web_cpu_ms: float | None = None  # of the processes that answer HTTP
    worker_cpu_ms: float | None = None  # of all that they started: trackers and decoders
    client_cpu_ms: float | None = None  # of this process: the clients share the machine with the service they measure
    rows: float | None = None  # written to the database
    database_bytes: float | None = None  # by which it grew
    log_bytes: float | None = (
        None  # written to disk (SQLite: by the web process) or to the write-ahead log (PostgreSQL)
    )
    sent_bytes: float | None = None  # HTTP, heads and bodies, from the client
    received_bytes: float | None = None  # the same to the client


@dataclass(frozen=True)
class LoadRow:
    """One measurement: so many sessions for so long."""

    engine: str
    workers: int
    particles: int
    rate_hz: float
    sessions: int
    frames_per_s: float  # answered
    p50_ms: float  # from the time at which a frame was due, not from when it could be sent
    p99_ms: float
    late: int  # frames that were due and not even sent before the end
    refused: int  # answered 429 or 503
    held: bool  # nothing late or refused, and p99 below the bound
    cost: Cost

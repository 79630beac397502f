"""How soon a service is ready, and what memory its idle processes take. Both are read from /proc, so only on Linux."""

from __future__ import annotations

import os
import time
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from statistics import median
from typing import Any

from rich.box import MARKDOWN
from rich.table import Table

from service.bench.load.cost import cpu_s, descendants

_PROC = Path("/proc")
_LOOK_S, _IDLE_SHARE, _MOST_LOOKS = 1.0, 0.05, 60  # idle: all processes together use so little of a core for so long
_NAMES = {"service.workers.decode_child": "decoder", "service.workers.child": "worker", "multiprocessing": "other"}


@dataclass(frozen=True)
class Start:
    """One start, kernels cached: until ``/readyz`` answers 200, and the computing time of all processes until then."""

    ready_ms: float
    cpu_ms: float


@dataclass(frozen=True)
class Memory:
    """Of one process: pages that it shares with others in equal parts (PSS), and those that it has alone."""

    process: str
    pss_mb: float
    private_mb: float


def computed_s(pid: int) -> float:
    """Computing time of a process and all that it started."""
    return cpu_s(pid) + sum(cpu_s(child) for child in descendants(pid))


def wait_until_idle(pid: int) -> None:
    """Until what a service still does after it is ready is done: its spare worker, its decoder."""
    for _ in range(_MOST_LOOKS):
        before = computed_s(pid)
        time.sleep(_LOOK_S)
        if computed_s(pid) - before < _IDLE_SHARE * _LOOK_S:
            return


def memory_of(pid: int) -> list[Memory]:
    """Of every process of a service. Raises ``PermissionError`` where this user may not see it: they hide theirs."""
    return [_memory(pid, "web"), *(_memory(child, _name(child)) for child in descendants(pid))]


def _memory(pid: int, name: str) -> Memory:
    lines = (_PROC / str(pid) / "smaps_rollup").read_text().splitlines()[1:]
    kib = {line.split()[0].rstrip(":"): int(line.split()[1]) for line in lines}
    return Memory(name, kib["Pss"] / 1024, (kib["Private_Dirty"] + kib["Private_Clean"]) / 1024)


def _name(pid: int) -> str:
    command = (_PROC / str(pid) / "cmdline").read_text()
    return next((name for part, name in _NAMES.items() if part in command), "other")


def start_document(machine: Mapping[str, Any], starts: Sequence[Start], memory: Sequence[Memory]) -> dict[str, Any]:
    """The JSON: every start in ``rows``, their medians, and the memory of each process; none where it is hidden."""
    return {
        "machine": dict(machine),
        "load": round(os.getloadavg()[0], 1),  # with more than there are cores, computing time tells more
        "rows": [_rounded(start) for start in starts],
        "median": {
            "ready_ms": round(median(start.ready_ms for start in starts)),
            "cpu_ms": round(median(start.cpu_ms for start in starts)),
        },
        "memory": [_rounded(process) for process in memory],
        "pss_mb": round(sum(process.pss_mb for process in memory), 1) if memory else None,
        "absent": {} if memory else {"memory": "the processes hide theirs from other users than root"},
    }


def _rounded(row: Start | Memory) -> dict[str, Any]:
    return {name: round(value, 1) if isinstance(value, float) else value for name, value in asdict(row).items()}


def start_tables(document: Mapping[str, Any]) -> tuple[Table, ...]:
    """The starts, and the memory where it is known."""
    starts = Table("start", "ready ms", "CPU ms", box=MARKDOWN)
    for n, row in enumerate(document["rows"], 1):
        starts.add_row(str(n), f"{row['ready_ms']:.0f}", f"{row['cpu_ms']:.0f}")
    starts.add_row("median", *(str(document["median"][name]) for name in ("ready_ms", "cpu_ms")))
    if not document["memory"]:
        return (starts,)
    memory = Table("process", "PSS MB", "private MB", box=MARKDOWN)
    for row in document["memory"]:
        memory.add_row(row["process"], f"{row['pss_mb']:.1f}", f"{row['private_mb']:.1f}")
    memory.add_row("all", f"{document['pss_mb']:.1f}", f"{sum(row['private_mb'] for row in document['memory']):.1f}")
    return starts, memory

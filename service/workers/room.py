"""How many tracking processes there is room for: on a machine, in a container, in a systemd unit."""

from __future__ import annotations

import os
from collections.abc import Iterator
from math import ceil
from pathlib import Path

WORKER_BYTES = 1 << 30  # a worker and its decoder at work take a third of it; large models and frames the rest
_GROUPS = Path("/sys/fs/cgroup")


def workers_that_fit() -> int:
    """One for each core that this process may use, as far as its memory goes; at least one."""
    return max(1, min(cores(), memory_bytes() // WORKER_BYTES))


def cores(own: Path = Path("/proc/self/cgroup"), groups: Path = _GROUPS) -> int:
    """Of the affinity mask, or of a control group's share of computing time (cgroup v2, ``cpu.max``)."""
    limits = [len(os.sched_getaffinity(0))]
    for told in _told("cpu.max", own, groups):
        quota, period = told.split()
        if quota != "max":
            limits.append(max(1, ceil(int(quota) / int(period))))
    return min(limits)


def memory_bytes(own: Path = Path("/proc/self/cgroup"), groups: Path = _GROUPS) -> int:
    """Of the machine, or of a control group (cgroup v2, ``memory.max``)."""
    limits = [os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")]
    limits += [int(told) for told in _told("memory.max", own, groups) if told != "max"]
    return min(limits)


def _told(name: str, own: Path, groups: Path) -> Iterator[str]:
    """What a file says of the process's control group and of each that holds it; nothing without cgroup v2."""
    try:
        lines = own.read_text().splitlines()
    except OSError:
        return
    for path in (line.removeprefix("0::").strip("/") for line in lines if line.startswith("0::")):
        group = groups / path
        for folder in (group, *group.parents):
            if folder.is_relative_to(groups) and (folder / name).is_file():
                yield (folder / name).read_text().strip()

"""What memory each process of a service may take (docs/operations.md, "Memory"), and the most that it took."""

from pathlib import Path

BOUNDS_MB = {"web": 1024, "worker": 2048, "decoder": 2304}
"""With the settings as they come. A decoder's is SKYPOSE_DECODE_MEMORY_MB and what it took before that held."""

_NAMES = {"service.workers.decode_child": "decoder", "service.workers.child": "worker"}


def descendants(pid: int) -> list[int]:
    """Processes that a process started, and theirs."""
    found: list[int] = []
    for task in Path(f"/proc/{pid}/task").glob("*/children"):
        try:
            children = [int(child) for child in task.read_text().split()]
        except OSError:
            continue
        for child in children:
            found += [child, *descendants(child)]
    return found


def status(pid: int, name: str) -> int:
    """A number of a process's status; 0 of one that has ended."""
    try:
        lines = Path(f"/proc/{pid}/status").read_text().splitlines()
    except OSError:
        return 0
    return next((int(line.split()[1]) for line in lines if line.startswith(f"{name}:")), 0)


def peaks_mb(pid: int) -> dict[str, int]:
    """The most that any process of each kind has had at once, MiB, of those that are there now."""
    found = {"web": status(pid, "VmHWM") >> 10}
    for child in descendants(pid):
        try:
            command = Path(f"/proc/{child}/cmdline").read_text()
        except OSError:
            continue
        name = next((name for part, name in _NAMES.items() if part in command), None)
        if name is not None:
            found[name] = max(found.get(name, 0), status(child, "VmHWM") >> 10)
    return found


def over_bound(peaks: dict[str, int]) -> list[str]:
    """Kinds of processes that took more than they may."""
    return [name for name, peak in peaks.items() if peak > BOUNDS_MB[name]]

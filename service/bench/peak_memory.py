"""The largest resident size of this process while something runs."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

_CLEAR = Path("/proc/self/clear_refs")
_STATUS = Path("/proc/self/status")
_RESET_PEAK = "5"  # proc(5): sets VmHWM to the present resident size


def peak_mib(run: Callable[[], object]) -> float | None:
    """MiB at the peak of ``run()``; None where the system does not tell (only Linux does)."""
    try:
        _CLEAR.write_text(_RESET_PEAK)
    except OSError:
        run()
        return None
    run()
    line = next(line for line in _STATUS.read_text().splitlines() if line.startswith("VmHWM:"))
    return int(line.split()[1]) / 1024

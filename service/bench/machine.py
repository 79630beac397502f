"""What the figures were measured on."""

from __future__ import annotations

import os
import platform
from collections.abc import Mapping
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import numpy as np

from gpu.device import find_devices


def describe_machine() -> dict[str, str | int | float]:
    """Processor, memory, system, OpenCL device, versions."""
    usable = [report for report in find_devices() if report.rejected is None]
    return {
        "cpu": _cpu_name(),
        "cores": len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1,
        "memory_gib": _memory_gib(),
        "system": platform.platform(),
        "opencl": f"{usable[0].name} ({usable[0].platform} {usable[0].driver})" if usable else "none",
        "python": platform.python_version(),
        "numpy": np.__version__,
        "skypose": _own_version(),
    }


def machine_line(machine: Mapping[str, Any]) -> str:
    """The same in one line, for a report."""
    return (
        f"{machine['cpu']}, {machine['cores']} cores, {machine['memory_gib']} GiB; {machine['system']}; "
        f"OpenCL: {machine['opencl']}; Python {machine['python']}, NumPy {machine['numpy']}, "
        f"skypose {machine['skypose']}"
    )


def _own_version() -> str:
    try:
        return version("skypose")
    except PackageNotFoundError:  # run from the source tree, as deploy/gpu-check does with carried wheels
        return "from source"


def _cpu_name() -> str:
    info = Path("/proc/cpuinfo")
    if info.exists():
        for line in info.read_text().splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    return platform.processor() or platform.machine()


def _memory_gib() -> float:
    try:
        return round(os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") / 2**30, 1)
    except (ValueError, OSError):  # a system that does not say
        return 0.0

"""Choose an OpenCL device: look at every platform, try a small kernel on each device, say what was found."""

from __future__ import annotations

import atexit
import functools
import os
import shutil
import tempfile
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pyopencl as cl

from gpu.errors import DeviceError
from gpu.kernel_cache import INSTALLED, take_kept

PROBE = "__kernel void probe(__global int *out) { out[get_global_id(0)] = (int)get_global_id(0) * 3 + 1; }"


@dataclass(frozen=True)
class DeviceReport:
    """One device that was looked at."""

    platform: str
    name: str
    version: str
    kind: str  # "cpu", "gpu" or "other"
    rejected: str | None  # why it cannot be used; None: it passed the probe
    index: tuple[int, int]  # platform, device
    extensions: tuple[str, ...] = ()
    driver: str = ""  # its version


@functools.cache
def find_devices() -> tuple[DeviceReport, ...]:
    """Look at every device of every platform once per process, best first: usable GPUs, usable others, the rest."""
    _use_private_kernel_cache()
    found = [
        _inspect(platform, device, (p, d))
        for p, platform in enumerate(_platforms())
        for d, device in enumerate(_devices(platform))
    ]
    return tuple(sorted(found, key=lambda r: (r.rejected is not None, r.kind != "gpu", r.index)))


def no_device_reason() -> str:
    """Why an OpenCL device that is looked for cannot be had, for people."""
    found = find_devices()
    if not found:
        return "no OpenCL platform is installed (on Debian: apt install pocl-opencl-icd)"
    rejected = "; ".join(f"{r.name} on {r.platform}: {r.rejected}" for r in found if r.rejected)
    return rejected or f"there is only {', '.join(r.name for r in found)}"


def first_device(kind: str, reports: Iterable[DeviceReport] | None = None) -> DeviceReport:
    """The first usable device of a kind (``cpu``, ``gpu``). Raises ``DeviceError`` where OpenCL has none."""
    for report in find_devices() if reports is None else reports:
        if report.rejected is None and report.kind == kind:
            return report
    raise DeviceError(f"no {kind.upper()} is an OpenCL device: {no_device_reason()}")


def first_kind(*kinds: str, reports: Iterable[DeviceReport] | None = None) -> str:
    """The first of these kinds of which a device is usable; the first of all where none is."""
    usable = {report.kind for report in (find_devices() if reports is None else reports) if report.rejected is None}
    return next((kind for kind in kinds if kind in usable), kinds[0])


def open_device(report: DeviceReport) -> cl.Device:
    """The device that a report is about."""
    platform, device = report.index
    return cl.get_platforms()[platform].get_devices()[device]


def _use_private_kernel_cache() -> None:
    """PoCL's cache of built kernels must not be shared with other users, who could put kernels of theirs into it.

    It begins with those that were built when the program was installed: building all takes ten seconds.
    """
    if "POCL_CACHE_DIR" not in os.environ:
        folder = tempfile.mkdtemp(prefix="skypose-pocl-")
        atexit.register(shutil.rmtree, folder, ignore_errors=True)
        take_kept(INSTALLED, Path(folder))
        os.environ["POCL_CACHE_DIR"] = folder


def _platforms() -> list[cl.Platform]:
    try:
        return list(cl.get_platforms())
    except cl.Error:  # the loader says "platform not found" where no driver is installed
        return []


def _devices(platform: cl.Platform) -> list[cl.Device]:
    try:
        return list(platform.get_devices())
    except cl.Error:  # "device not found": a driver without its hardware
        return []


def _inspect(platform: cl.Platform, device: cl.Device, index: tuple[int, int]) -> DeviceReport:
    kinds = {cl.device_type.GPU: "gpu", cl.device_type.CPU: "cpu"}
    return DeviceReport(
        platform=platform.name.strip(),
        name=device.name.strip(),
        version=device.version.strip(),
        kind=next((name for kind, name in kinds.items() if device.type & kind), "other"),
        rejected=_probe(device),
        index=index,
        extensions=tuple(device.extensions.split()),
        driver=device.driver_version.strip(),
    )


def _probe(device: cl.Device) -> str | None:
    """Build and run a small kernel; None if the answer is right."""
    try:
        context = cl.Context([device])
        queue = cl.CommandQueue(context)
        out = np.zeros(64, np.int32)
        buffer = cl.Buffer(context, cl.mem_flags.WRITE_ONLY, out.nbytes)
        kernel = cl.Kernel(cl.Program(context, PROBE).build(), "probe")
        kernel(queue, (64,), None, buffer)
        cl.enqueue_copy(queue, out, buffer)
    except (cl.Error, OSError) as error:
        return f"the probe kernel failed: {str(error).splitlines()[0]}"
    return None if np.array_equal(out, np.arange(64) * 3 + 1) else "the probe kernel's answer is wrong"

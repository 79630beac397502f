"""Choose an OpenCL device: look at every platform, try a small kernel on each device, say what was found."""

from __future__ import annotations

import functools
import os
import tempfile
from dataclasses import dataclass

import numpy as np

PROBE = "__kernel void probe(__global int *out) { out[get_global_id(0)] = (int)get_global_id(0) * 3 + 1; }"


class DeviceError(RuntimeError):
    """No OpenCL device answers, or the one in use failed."""


class DeviceLostError(DeviceError):
    """The device failed or disappeared during a call; open the scorer anew."""


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


@functools.cache
def find_devices() -> tuple[DeviceReport, ...]:
    """Look at every device of every platform once per process, best first (usable GPUs, then CPUs)."""
    _use_private_kernel_cache()
    try:
        import pyopencl as cl
    except ImportError:
        return ()
    try:
        platforms = cl.get_platforms()
    except cl.Error:  # the loader says "platform not found" when no driver is installed
        return ()
    found = [_inspect(cl, p, d) for p in range(len(platforms)) for d in range(_count(cl, platforms[p]))]
    return tuple(sorted(found, key=lambda r: (r.rejected is not None, r.kind != "gpu", r.index)))


def no_device_reason() -> str:
    """Why no OpenCL device can be used, for people."""
    found = find_devices()
    if not found:
        return "no OpenCL platform is installed (on Debian: apt install pocl-opencl-icd)"
    return "; ".join(f"{r.name} on {r.platform}: {r.rejected}" for r in found if r.rejected)


def _use_private_kernel_cache() -> None:
    """PoCL's cache of built kernels must not be shared with other users or running processes."""
    if "POCL_CACHE_DIR" not in os.environ:
        os.environ["POCL_CACHE_DIR"] = _cache_directory().name


@functools.cache
def _cache_directory() -> tempfile.TemporaryDirectory[str]:
    return tempfile.TemporaryDirectory(prefix="skypose-pocl-", ignore_cleanup_errors=True)


def _count(cl: object, platform: object) -> int:
    try:
        return len(platform.get_devices())  # type: ignore[attr-defined]
    except cl.Error:  # type: ignore[attr-defined]
        return 0


def _inspect(cl: object, p: int, d: int) -> DeviceReport:
    import pyopencl

    platform = pyopencl.get_platforms()[p]
    device = platform.get_devices()[d]
    kind = {pyopencl.device_type.GPU: "gpu", pyopencl.device_type.CPU: "cpu"}
    return DeviceReport(
        platform=platform.name.strip(),
        name=device.name.strip(),
        version=device.version.strip(),
        kind=next((v for k, v in kind.items() if device.type & k), "other"),
        rejected=_probe(device),
        index=(p, d),
        extensions=tuple(device.extensions.split()),
    )


def _probe(device: object) -> str | None:
    """Build and run a small kernel; None if the answer is right."""
    import pyopencl as cl

    try:
        context = cl.Context([device])
        queue = cl.CommandQueue(context)
        out = np.zeros(64, np.int32)
        buffer = cl.Buffer(context, cl.mem_flags.WRITE_ONLY, out.nbytes)
        kernel = cl.Kernel(cl.Program(context, PROBE).build(), "probe")
        kernel(queue, (64,), None, buffer)
        cl.enqueue_copy(queue, out, buffer)
    except (cl.Error, RuntimeError, OSError) as error:
        return f"the probe kernel failed: {str(error).splitlines()[0]}"
    return None if np.array_equal(out, np.arange(64) * 3 + 1) else "the probe kernel's answer is wrong"

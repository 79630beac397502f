"""How many particles fit into one call, so that a million of them, or a huge frame, run in bounded memory."""

from __future__ import annotations

from collections.abc import Iterator

import pyopencl as cl

LARGEST_BATCH_BYTES = 256 << 20  # more gains nothing: the device is busy long before
SHARE_OF_DEVICE = 0.125


def batch_size(bytes_per_particle: int, device_bytes: int, largest_allocation: int) -> int:
    """Particles per call, at least one.

    ``bytes_per_particle`` counts what is allocated for each (transforms in, scores out); ``device_bytes`` and
    ``largest_allocation`` are the device's limits.
    """
    allowed = min(LARGEST_BATCH_BYTES, int(device_bytes * SHARE_OF_DEVICE), largest_allocation)
    return max(1, allowed // bytes_per_particle)


def batches(device: cl.Device, n: int, bytes_per_particle: int) -> Iterator[slice]:
    """Slices of n particles, each of which fits."""
    size = batch_size(bytes_per_particle, device.global_mem_size, device.max_mem_alloc_size)
    return (slice(start, min(start + size, n)) for start in range(0, n, size))


def group_count(compute_units: int, per_unit: int, bytes_per_group: int, device_bytes: int, largest: int) -> int:
    """Work-groups that run side by side, each with its own scratch memory: fewer where that would not fit."""
    allowed = min(int(device_bytes * SHARE_OF_DEVICE), largest)
    return max(1, min(compute_units * per_unit, allowed // max(1, bytes_per_group)))

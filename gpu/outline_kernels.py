"""The outline's kernels for one mesh on one device: what a scorer and a batch of scorers both open."""

from __future__ import annotations

from dataclasses import dataclass

import pyopencl as cl

from gpu.clusters import build_table
from gpu.device import DeviceReport, open_device
from gpu.mesh import Mesh
from gpu.occlusion import Occlusion
from gpu.outline_cpu import CpuOutline, DeviceTable
from gpu.outline_gpu import GpuOutline


@dataclass(frozen=True)
class OutlineKernels:
    """Kernels with the mesh's table on their device; ``by_item`` is for CPUs."""

    queue: cl.CommandQueue
    by_group: GpuOutline
    by_item: CpuOutline | None


def open_kernels(mesh: Mesh, report: DeviceReport, kernel: str | None) -> OutlineKernels:
    """Build them. ``kernel`` is ``"cpu"`` or ``"gpu"``; None: the device's kind decides. Raises OpenCL's errors."""
    queue = cl.CommandQueue(cl.Context([open_device(report)]))
    table = build_table(mesh, Occlusion(queue).hidden_pieces)
    on_device = DeviceTable.upload(queue.context, table, len(mesh.parts))
    use_cpu = (kernel or report.kind) == "cpu"
    return OutlineKernels(queue, GpuOutline(queue, on_device), CpuOutline(queue, on_device) if use_cpu else None)

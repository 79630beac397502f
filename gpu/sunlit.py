"""Runs ``kernels/sunlit.cl``: bodies drawn with what faces the camera, and a matt body's light fitted to a frame.

On a CPU: a frame asks for tens of poses at most, and its numbers lie there.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pyopencl as cl
from numpy.typing import NDArray

from gpu.device import DeviceReport, first_device, open_device
from gpu.looping import Floats, Map
from gpu.mesh import Mesh
from gpu.program import KernelArgument, build, constant, device_errors, zero
from gpu.zbuffer import Visible

LANES = 16
PLANES = 4


@dataclass(frozen=True)
class LightFit:
    """How the light is fitted: see ``service.imaging.shading``."""

    towards_sun: Floats  # (G, 3) first guesses
    rounds: int
    every: int  # how manieth pixel counts
    outlier: float
    covered: float


class Sunlit:
    """Draws one mesh on one OpenCL device. Owned, used and closed by one thread."""

    def __init__(self, mesh: Mesh, report: DeviceReport, fit: LightFit) -> None:
        self.name = f"opencl:sunlit:{report.name}"
        self._parts = len(mesh.parts)
        self._vertices, self._faces = mesh.n_vertices, mesh.n_faces
        self._every = fit.every
        with device_errors(self.name):
            self._queue = cl.CommandQueue(cl.Context([open_device(report)]))
            self._context = self._queue.context
            options = {"ROUNDS": fit.rounds, "EVERY": fit.every, "OUTLIER": fit.outlier, "COVERED": fit.covered}
            kinds = {int: "{}", float: "{}f"}
            values = [f"-D{name}={kinds[type(value)].format(value)}" for name, value in options.items()]
            program = build(self._context, "lanes.cl", "sunlit.cl", options=values)
            self._left_over, self._draw = (cl.Kernel(program, name) for name in ("left_over", "draw"))
            vertices = np.zeros(3 * self._vertices + LANES, np.float32)
            vertices[: 3 * self._vertices] = np.concatenate([p.vertices for p in mesh.parts]).T.ravel()
            starts = np.cumsum([0, *(len(p.vertices) for p in mesh.parts)]).astype(np.int32)
            faces = np.insert(mesh.faces, 3, 0, axis=1).astype(np.int32)
            self._table = tuple(constant(self._context, array) for array in (vertices, starts, faces))
            self._guesses = constant(self._context, fit.towards_sun.astype(np.float32))
            self._n_guesses = len(fit.towards_sun)

    def draw(self, part_transforms: NDArray[np.floating], side: int) -> Sequence[Visible]:
        """(N, P, 3, 4) transforms to a patch of ``side`` x ``side`` pixels -> what each view shows."""
        n = len(part_transforms)
        face, depth = np.empty((n, side, side), np.int32), np.empty((n, side, side), np.float32)
        with device_errors(self.name):
            seen, deep = (cl.Buffer(self._context, cl.mem_flags.READ_WRITE, face.nbytes) for _ in range(2))
            self._launch(self._draw, part_transforms, side, 0, (seen, deep))
            cl.enqueue_copy(self._queue, face, seen)
            cl.enqueue_copy(self._queue, depth, deep)
        return [Visible(f.astype(np.int64), d.astype(np.float64)) for f, d in zip(face, depth, strict=True)]

    def left_over(
        self, part_transforms: NDArray[np.floating], brightness: Map, light: NDArray[np.bool_], taps: Floats
    ) -> Floats:
        """(N, P, 3, 4) transforms -> (N, 2) sums of absolute brightness: all there is, and what the best light leaves.

        ``brightness`` and ``light``, where the frame speaks for an object, are (S, S), ``taps`` the point spread along
        one axis, an odd number of them.
        """
        sums = np.empty((len(part_transforms), 2), np.float32)
        with device_errors(self.name):
            out = cl.Buffer(self._context, cl.mem_flags.WRITE_ONLY, sums.nbytes)
            arrays = brightness.astype(np.float32), light.astype(np.uint8), taps.astype(np.float32)
            seen, lit, spread = (constant(self._context, array) for array in arrays)
            radius = len(taps) // 2
            fit = np.int32(radius), self._guesses, np.int32(self._n_guesses)
            self._launch(self._left_over, part_transforms, len(brightness), radius, (seen, lit, spread, *fit, out))
            cl.enqueue_copy(self._queue, sums, out)
        return sums.astype(np.float64)

    def close(self) -> None:
        """Wait for the device."""
        self._queue.finish()

    def _launch(
        self,
        kernel: cl.Kernel,
        transforms: NDArray[np.floating],
        side: int,
        radius: int,
        given: tuple[KernelArgument, ...],
    ) -> None:
        items = min(self._queue.device.max_compute_units, len(transforms))
        each = self._scratch(side, radius)
        memory = cl.Buffer(self._context, cl.mem_flags.READ_WRITE, 4 * each * items)
        on_device = constant(self._context, np.ascontiguousarray(transforms, np.float32))
        vertices, starts, faces = self._table
        mesh = np.int32(self._parts), vertices, starts, faces, np.int32(self._faces)
        head = (on_device, np.int32(len(transforms)), *mesh, np.int32(side))
        kernel(self._queue, (items,), (1,), *head, *given, memory, np.int32(each), zero(self._context))

    def _scratch(self, side: int, radius: int) -> int:
        """Numbers (float32) that ``take_view`` hands out, rounded up to whole cache lines."""
        stride = (side + 2 * radius + 2 * LANES - 1) // LANES * LANES
        most = (side * side // self._every + 2 * LANES) // LANES * LANES
        size = 3 * (self._vertices + LANES) + 2 * side * side + 2 * PLANES * side * stride + (PLANES + 3) * most
        return -(-(size + LANES) // 32) * 32


def open_sunlit(mesh: Mesh, fit: LightFit) -> Sunlit:
    """On the machine's CPU. Raises ``DeviceError`` where OpenCL does not know it."""
    return Sunlit(mesh, first_device("cpu"), fit)

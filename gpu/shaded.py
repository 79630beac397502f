"""Runs ``kernels/shaded.cl``: sunlit pictures of a body with cast shadows, many poses in one launch."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pyopencl as cl
from numpy.typing import NDArray

from gpu.device import DeviceReport, first_device, open_device
from gpu.lens import NEAREST, NO_LENS, Lens, magnified
from gpu.mesh import Mesh
from gpu.program import KernelArgument, Scratch, build, constant, device_errors, work_items, zero
from gpu.shaded_faces import LANES, FaceTable, Indices, face_table
from gpu.shaded_reference import BIAS_TEXELS, EVEN_PLANES, STEEPEST
from gpu.shaded_views import SIDE, views_of_part

Numbers = NDArray[np.float32]
EVEN_LIGHT = 0.04  # of ``pictures``: what a body shows of light from everywhere, as a share of the Sun's
FILES = ("lanes.cl", "shaded_faces.cl", "shaded_light.cl", "shaded.cl")


class ShadedBody:
    """Draws one mesh on one OpenCL device. Owned, used and closed by one thread.

    All methods take ``part_transforms`` (N, P, 3, 4): body point at rest -> (x px, y px, depth px) of a square patch
    of ``side`` pixels whose first pixel begins at (0, 0); smaller depth is nearer. ``towards_sun`` is (3,) or (N, 3),
    in the same axes: (0, 0, -1) is a Sun behind the camera. ``supersample`` samples along each axis of a pixel are
    drawn. ``shadow_px`` is the resolution of cast shadows, texels across the body's diameter; 0: there are none.
    ``lens``: of a pinhole camera, in pixels of the patch (``gpu.lens``).
    A pose with a number that is not finite gives zeros.
    """

    def __init__(self, mesh: Mesh, groups: NDArray[np.integer], report: DeviceReport, drop_hidden: bool = True) -> None:
        self.name = f"opencl:shaded:{report.name}"
        self.n_groups = int(groups.max(initial=0)) + 1
        self._n_parts, self._radius = len(mesh.parts), np.float32(mesh.radius)
        with device_errors(self.name):
            self._queue = cl.CommandQueue(cl.Context([open_device(report)]))
            self._context = self._queue.context
            self._memory = Scratch(self._context)
            options = [
                f"-DBIAS={BIAS_TEXELS}f",
                f"-DSTEEPEST={STEEPEST}f",
                f"-DNEAREST={NEAREST}f",
                f"-DEVEN_PLANES={EVEN_PLANES}",
            ]
            program = build(self._context, *FILES, options=options)
            kernels = (cl.Kernel(program, name) for name in ("planes", "combined", "mark_seen"))
            self._planes, self._combined, self._mark_seen = kernels
        self._take(face_table(mesh, groups))
        if drop_hidden:
            self._take(face_table(mesh, groups, self._seen(mesh)))

    def _take(self, table: FaceTable) -> None:
        """Bring the faces to the device."""
        self._table = table
        with device_errors(self.name):
            self._faces = [constant(self._context, array) for array in (table.corners, table.groups, table.shut)]
            self._show(table.starts, table.boxes)

    def _show(self, starts: Indices, boxes: Numbers) -> None:
        """Draw these parts of the faces on the device."""
        corners, groups, shut = self._faces
        self._body: tuple[KernelArgument, ...] = (
            *(corners, constant(self._context, starts), groups, shut, constant(self._context, boxes)),
            *(np.int32(v) for v in (len(boxes), self._table.n_padded, self._table.bits)),
            self._radius,
        )

    def _seen(self, mesh: Mesh) -> NDArray[np.bool_]:
        """(F,) whether a face is seen from anywhere outside its part, when the part is alone."""
        table, marks = self._table, np.zeros(self._table.n_padded, np.uint8)
        for number, part in enumerate(mesh.parts):
            with device_errors(self.name):
                self._show(table.starts[number : number + 2], table.boxes[number : number + 1])
            self._launch(self._mark_seen, (views_of_part(part),), marks, (SIDE, 1, 0), None, ())
        seen = np.zeros(mesh.n_faces, dtype=bool)
        seen[self._table.origin[marks > 0]] = True
        return seen

    def planes(
        self,
        part_transforms: NDArray[np.floating],
        towards_sun: NDArray[np.floating],
        *,
        side: int,
        supersample: int,
        shadow_px: int,
        gloss: tuple[float, ...] = (),
        lens: Lens = NO_LENS,
    ) -> Numbers:
        """(N, G + 4 + L G, side, side): each group in the Sun's light, coverage, normals, then each group's lobes.

        A group's plane is the mean over a pixel's samples of n . s where the group is seen and the Sun reaches it;
        a lobe's that of (n . h)^k, h half-way between the Sun and the camera. Normals (3): the mean of n, whatever is
        seen.
        """
        given = self._given(part_transforms, towards_sun)
        out = np.zeros((len(given[0]), self.n_groups * (1 + len(gloss)) + EVEN_PLANES, side, side), np.float32)
        self._launch(self._planes, given, out, (side, supersample, shadow_px), gloss, (), lens)
        return out

    def combined(
        self,
        part_transforms: NDArray[np.floating],
        towards_sun: NDArray[np.floating],
        coefficients: NDArray[np.floating],
        *,
        side: int,
        supersample: int,
        shadow_px: int,
        gloss: tuple[float, ...] = (),
        lens: Lens = NO_LENS,
    ) -> Numbers:
        """(N, side, side) sums of the planes times ``coefficients``, (G + 4 + L G,) or (N, G + 4 + L G)."""
        given = self._given(part_transforms, towards_sun)
        out = np.zeros((len(given[0]), 1, side, side), np.float32)
        self._sum(given, coefficients, out, (side, supersample, shadow_px), gloss, lens)
        return out[:, 0]

    def pictures(
        self,
        part_transforms: NDArray[np.floating],
        towards_sun: NDArray[np.floating],
        *,
        side: int,
        supersample: int,
        shadow_px: int,
        lens: Lens = NO_LENS,
    ) -> Numbers:
        """(N, 2, side, side): all groups in the Sun's light with ``EVEN_LIGHT`` added, and the coverage."""
        given = self._given(part_transforms, towards_sun)
        out = np.zeros((len(given[0]), 2, side, side), np.float32)
        alike = np.concatenate([np.ones(self.n_groups), [EVEN_LIGHT, 0.0, 0.0, 0.0]])
        self._sum(given, alike, out, (side, supersample, shadow_px), (), lens)
        return out

    def close(self) -> None:
        """Wait for the device and give its memory back."""
        self._queue.finish()
        self._memory.close()

    def _given(
        self, part_transforms: NDArray[np.floating], towards_sun: NDArray[np.floating]
    ) -> tuple[Numbers, Numbers]:
        """Transforms (N, P, 3, 4) and unit vectors (N, 3), in memory order; poses that are not finite as zeros."""
        if part_transforms.ndim != 4 or part_transforms.shape[1:] != (self._n_parts, 3, 4):
            raise ValueError(f"transforms are {part_transforms.shape}, not (N, {self._n_parts}, 3, 4)")
        n = len(part_transforms)
        suns = np.broadcast_to(np.asarray(towards_sun, np.float64), (n, 3))
        length = np.linalg.norm(suns, axis=1, keepdims=True)
        finite = np.isfinite(part_transforms).all(axis=(1, 2, 3)) & np.isfinite(length[:, 0]) & (length[:, 0] > 0)
        suns = np.where(finite[:, None], suns / np.where(finite[:, None], length, 1.0), [0.0, 0.0, -1.0])
        moved = np.ascontiguousarray(part_transforms, np.float32)
        if not finite.all():
            moved = np.where(finite[:, None, None, None], moved, np.float32(0.0))
        return moved, suns.astype(np.float32)

    def _sum(
        self,
        given: tuple[Numbers, Numbers],
        coefficients: NDArray[np.floating],
        out: Numbers,
        sizes: tuple[int, int, int],
        gloss: tuple[float, ...],
        lens: Lens,
    ) -> None:
        count, n = self.n_groups * (1 + len(gloss)) + EVEN_PLANES, len(out)
        if coefficients.shape not in ((count,), (n, count)):
            raise ValueError(f"coefficients are {coefficients.shape}, not ({count},) or ({n}, {count})")
        with device_errors(self.name):
            share = constant(self._context, np.ascontiguousarray(coefficients, np.float32))
        every = count if coefficients.ndim == 2 else 0
        self._launch(self._combined, given, out, sizes, gloss, (share, np.int32(every), np.int32(out.shape[1])), lens)

    def _launch(
        self,
        kernel: cl.Kernel,
        given: tuple[Numbers, ...],
        out: NDArray[np.generic],
        sizes: tuple[int, int, int],
        gloss: tuple[float, ...] | None,
        more: tuple[KernelArgument, ...],
        lens: Lens = NO_LENS,
    ) -> None:
        side, supersample, shadow_px = sizes
        if min(side, supersample) < 1 or shadow_px < 0:
            raise ValueError(f"{side} px, {supersample} samples and {shadow_px} texels cannot be drawn")
        n = len(given[0])
        if n == 0:
            return
        stride = _lanes(side * supersample)
        shadow_side = shadow_px + 4 if shadow_px else 0
        shadow_stride = _lanes(shadow_side)
        numbers = (side, supersample, stride, shadow_px, shadow_side, shadow_stride, self.n_groups, len(gloss or ()))
        each = (
            side * supersample * stride
            + shadow_side * shadow_stride
            + (6 + len(gloss or ())) * self._table.n_padded
            + (1 + EVEN_PLANES) * stride
        )
        each = -(-(each + 2 * LANES) // 32) * 32
        with device_errors(self.name):
            items = work_items(self._queue.device, n, 4 * each)
            flags = cl.mem_flags
            inputs = (cl.Buffer(self._context, flags.READ_ONLY | flags.USE_HOST_PTR, hostbuf=one) for one in given)
            result = cl.Buffer(self._context, flags.READ_WRITE | flags.USE_HOST_PTR, hostbuf=out)
            exponents = () if gloss is None else (constant(self._context, np.asarray(gloss, np.float32)),)
            counter = zero(self._context)
            scratch = self._memory.of(4 * each * items)
            focal, *middle = magnified(lens, supersample)
            seen = (np.float32(v) for v in (1 / focal, *(v - 0.5 for v in middle)))
            head = (*inputs, np.int32(n), *self._body, *(np.int32(v) for v in numbers), *seen, *exponents)
            kernel(self._queue, (items,), (1,), *head, result, scratch, np.int32(each), counter, *more)
            mapped, _ = cl.enqueue_map_buffer(self._queue, result, cl.map_flags.READ, 0, out.shape, out.dtype)
            mapped.base.release(self._queue)
            self._queue.finish()


def open_shaded(
    mesh: Mesh,
    groups: NDArray[np.integer],
    *,
    reports: Sequence[DeviceReport] | None = None,
    kind: str = "cpu",
    drop_hidden: bool = True,
) -> ShadedBody:
    """On the first usable device of this kind. ``groups`` (F,): see ``gpu.surface_groups``.

    With ``drop_hidden``, faces that cannot be seen from outside their part are left out, once for all.
    Raises ``DeviceError`` where OpenCL has none.
    """
    if len(groups) != mesh.n_faces:
        raise ValueError(f"{len(groups)} groups are given for {mesh.n_faces} faces")
    return ShadedBody(mesh, groups, first_device(kind, reports), drop_hidden)


def _lanes(count: int) -> int:
    return -(-count // LANES) * LANES

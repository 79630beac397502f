"""Sunlit pictures of a body with cast shadows, many poses in one launch: ``kernels/shaded.cl``, ``shaded_gpu.cl``."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from gpu.cut import Cut, Window, window_around
from gpu.device import DeviceReport, first_device, open_device
from gpu.lens import NO_LENS, Lens
from gpu.mesh import Mesh
from gpu.program import constant, device_errors
from gpu.shaded_faces import FaceTable, Indices, face_table
from gpu.shaded_forms import FacesOnDevice, Sizes, form_on
from gpu.shaded_reference import DARK, EVEN_PLANES, Around
from gpu.shaded_views import SIDE, views_of_part

Numbers = NDArray[np.float32]


class ShadedBody:
    """Draws one mesh on one OpenCL device. Owned, used and closed by one thread.

    All methods take ``part_transforms`` (N, P, 3, 4): body point at rest -> (x px, y px, depth px) of a square patch
    of ``side`` pixels whose first pixel begins at (0, 0); smaller depth is nearer. ``towards_sun`` is (3,) or (N, 3),
    in the same axes: (0, 0, -1) is a Sun behind the camera. ``supersample`` samples along each axis of a pixel are
    drawn. ``shadow_px`` is the resolution of cast shadows, texels across the body's diameter; 0: there are none.
    ``lens``: of a pinhole camera, in pixels of the patch (``gpu.lens``). ``around``: light from all around, which
    casts no shadows: a face of normal n has max(0, around[:3] . n + around[3]) of it, the Sun's full light being 1.
    A pose with a number that is not finite gives zeros.
    """

    def __init__(
        self,
        mesh: Mesh,
        groups: NDArray[np.integer],
        gloss_groups: NDArray[np.integer],
        report: DeviceReport,
        drop_hidden: bool = True,
        together: bool | None = None,
    ) -> None:
        self.name = f"opencl:shaded:{report.name}"
        self.n_groups, self.n_shiny = len(gloss_groups), int(gloss_groups.max(initial=0)) + 1
        groups = groups.astype(np.int32) | gloss_groups[groups].astype(np.int32) << 16  # as kernels take them apart
        self._n_parts = len(mesh.parts)
        self._radius = np.float32(mesh.radius)
        with device_errors(self.name):
            self._form = form_on(open_device(report), together)
        self._take(face_table(mesh, groups))
        if drop_hidden:
            self._take(face_table(mesh, groups, self._seen(mesh)))

    def _take(self, table: FaceTable) -> None:
        """Bring the faces to the device."""
        self._table = table
        with device_errors(self.name):
            self._faces = [constant(self._form.context, array) for array in (table.corners, table.groups, table.shut)]
            self._show(table.starts, table.boxes)

    def _show(self, starts: Indices, boxes: Numbers) -> None:
        """Draw these parts of the faces on the device."""
        corners, groups, shut = self._faces
        own = constant(self._form.context, starts), constant(self._form.context, boxes)
        numbers = (np.int32(v) for v in (len(boxes), self._table.n_padded, self._table.bits))
        buffers = (corners, own[0], groups, shut, own[1])
        self._shown = FacesOnDevice((*buffers, *numbers, self._radius), self._table.n_padded)

    def _seen(self, mesh: Mesh) -> NDArray[np.bool_]:
        """(F,) whether a face is seen from anywhere outside its part, when the part is alone."""
        table, marks = self._table, np.zeros(self._table.n_padded, np.uint8)
        for number, part in enumerate(mesh.parts):
            with device_errors(self.name):
                self._show(table.starts[number : number + 2], table.boxes[number : number + 1])
                marks |= self._form.seen(
                    self._shown, views_of_part(part), Sizes(SIDE, 1, 0, self.n_groups, self.n_shiny)
                )
        seen = np.zeros(mesh.n_faces, dtype=bool)
        seen[self._table.origin[marks > 0]] = True
        return seen

    def n_planes(self, gloss: tuple[float, ...] = ()) -> int:
        """G + 4 + L H: of G groups, coverage and normals, and of H groups of gloss for each of so many lobes."""
        return self.n_groups + EVEN_PLANES + self.n_shiny * len(gloss)

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
        around: Around = DARK,
    ) -> Numbers:
        """(N, G + 4 + L H, side, side): each group in the Sun's light, coverage, normals, then each lobe of each gloss.

        A group's plane is the mean over a pixel's samples of n . s where the group is seen and the Sun reaches it;
        a lobe's that of (n . h)^k, h half-way between the Sun and the camera. Normals (3): the mean of n, whatever is
        seen.
        """
        sizes = Sizes(side, supersample, shadow_px, self.n_groups, self.n_shiny, gloss, lens, around)
        return self._planes(part_transforms, towards_sun, sizes).whole()

    def cut(
        self,
        part_transforms: NDArray[np.floating],
        towards_sun: NDArray[np.floating],
        *,
        side: int,
        supersample: int,
        shadow_px: int,
        gloss: tuple[float, ...] = (),
        lens: Lens = NO_LENS,
        around: Around = DARK,
    ) -> Cut:
        """``planes``, of which what lies about the bodies may be left out."""
        sizes = Sizes(side, supersample, shadow_px, self.n_groups, self.n_shiny, gloss, lens, around)
        return self._planes(part_transforms, towards_sun, sizes)

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
        around: Around = DARK,
    ) -> Numbers:
        """(N, side, side) sums of the planes times ``coefficients``, (G + 4 + L H,) or (N, G + 4 + L H)."""
        given = self._given(part_transforms, towards_sun)
        sizes = Sizes(side, supersample, shadow_px, self.n_groups, self.n_shiny, gloss, lens, around)
        return self._sum(given, coefficients, 1, sizes)[:, 0]

    def pictures(
        self,
        part_transforms: NDArray[np.floating],
        towards_sun: NDArray[np.floating],
        *,
        side: int,
        supersample: int,
        shadow_px: int,
        lens: Lens = NO_LENS,
        around: Around = DARK,
    ) -> Numbers:
        """(N, 2, side, side): all groups in the Sun's light and that from all around, and the coverage."""
        given = self._given(part_transforms, towards_sun)
        alike = np.concatenate([np.ones(self.n_groups), np.zeros(EVEN_PLANES)])
        return self._sum(
            given, alike, 2, Sizes(side, supersample, shadow_px, self.n_groups, self.n_shiny, (), lens, around)
        )

    def close(self) -> None:
        """Wait for the device and give its memory back."""
        self._form.close()

    @property
    def drawn_faces(self) -> Indices:
        """Numbers of the mesh's faces that are not left out."""
        return self._table.origin[self._table.origin >= 0].astype(np.int32)

    @property
    def kernel_seconds(self) -> float:
        """Of the last pictures, as the device says; 0: it was not asked."""
        return self._form.kernel_seconds

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

    def _planes(self, part_transforms: NDArray[np.floating], towards_sun: NDArray[np.floating], sizes: Sizes) -> Cut:
        given, count = self._given(part_transforms, towards_sun), self.n_planes(sizes.gloss)
        seen = len(given[0]) and sizes.lens == NO_LENS
        return self._draw(
            given, sizes, window_around(given[0], self._table.boxes, sizes.side) if seen else None, None, count
        )

    def _sum(
        self, given: tuple[Numbers, Numbers], coefficients: NDArray[np.floating], pictures: int, sizes: Sizes
    ) -> Numbers:
        count, n = self.n_planes(sizes.gloss), len(given[0])
        if coefficients.shape not in ((count,), (n, count)):
            raise ValueError(f"coefficients are {coefficients.shape}, not ({count},) or ({n}, {count})")
        return self._draw(given, sizes, None, np.ascontiguousarray(coefficients, np.float32), pictures).values

    def _draw(
        self,
        given: tuple[Numbers, Numbers],
        sizes: Sizes,
        window: Window | None,
        share: Numbers | None,
        count: int,
    ) -> Cut:
        if min(sizes.side, sizes.supersample) < 1 or sizes.shadow_px < 0:
            raise ValueError(
                f"{sizes.side} px, {sizes.supersample} samples and {sizes.shadow_px} texels cannot be drawn"
            )
        if not len(given[0]):
            return Cut(np.empty((0, count, sizes.side, sizes.side), np.float32), 0, 0, sizes.side)
        whole = Window(0, 0, sizes.side, sizes.side)
        with device_errors(self.name):
            return self._form.draw(self._shown, given, sizes, window or whole, share, count)


def open_shaded(
    mesh: Mesh,
    groups: NDArray[np.integer],
    gloss_groups: NDArray[np.integer] | None = None,
    *,
    reports: Sequence[DeviceReport] | None = None,
    kind: str = "cpu",
    drop_hidden: bool = True,
    together: bool | None = None,
) -> ShadedBody:
    """On the first usable device of this kind. ``groups`` (F,), ``gloss_groups`` (G,): see ``gpu.surface_groups``;
    None: each has a gloss of its own.

    With ``drop_hidden``, faces that cannot be seen from outside their part are left out, once for all.
    ``together``: a work-group draws a pose, not a work-item; None: unless the device is a CPU.
    Raises ``DeviceError`` where OpenCL has none.
    """
    if len(groups) != mesh.n_faces:
        raise ValueError(f"{len(groups)} groups are given for {mesh.n_faces} faces")
    if gloss_groups is None:
        gloss_groups = np.arange(int(groups.max(initial=0)) + 1)
    return ShadedBody(mesh, groups, gloss_groups, first_device(kind, reports), drop_hidden, together)

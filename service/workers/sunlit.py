"""Bodies drawn into a patch of a frame, and what their light explains of it: on the CPU by OpenCL, or by NumPy."""

from __future__ import annotations

import warnings

import numpy as np
from numpy.typing import NDArray

from gpu.errors import DeviceError, ScorerError
from gpu.mesh import Mesh
from gpu.sunlit import LightFit, Sunlit, open_sunlit
from gpu.zbuffer import Visible, drawable, rasterise
from service.imaging.shading import COVERED, EVERY, OUTLIER, ROUNDS, TOWARDS_SUN, Patch, explained, log_times_less
from service.imaging.shading import point_spread as taps_of
from service.inference.state import Array
from service.workers.cache import Cache

FIT = LightFit(TOWARDS_SUN, ROUNDS, EVERY, OUTLIER, COVERED)


class SunlitBody:
    """One mesh. Without a ``device``, or once that has failed, NumPy does the same, more slowly."""

    def __init__(self, mesh: Mesh, device: Sunlit | None = None) -> None:
        self.mesh = mesh
        self._device = device

    def draw(self, transforms: NDArray[np.floating], patch: Patch) -> Visible:
        """What a pose (P, 3, 4) shows at each pixel of the patch."""
        placed, side = in_patch(transforms, patch), len(patch.brightness)
        if self._device is not None:
            try:
                return self._device.draw(placed[None], side)[0]
            except ScorerError as error:
                self._go_on_without(error)
        return self._rasterised(placed, side)

    def explained(self, transforms: NDArray[np.floating], patch: Patch) -> Array:
        """(N,) what ``imaging.shading.explained`` says of poses (N, P, 3, 4)."""
        placed = in_patch(transforms, patch)
        if self._device is not None:
            try:
                taps = taps_of(patch.blur_px)
                sums = self._device.left_over(placed, patch.brightness, patch.light, taps)
                return log_times_less(sums[:, 0], sums[:, 1])
            except ScorerError as error:
                self._go_on_without(error)
        return np.array([self._explained(one, patch) for one in placed])

    def normals(self, transforms: Array, face: NDArray[np.int64]) -> Array:
        """(n, 3) unit normals of faces (n,) of a posed body, away from those who see them, in the camera frame."""
        linear = transforms[self.mesh.part_of[face], :, :3]
        turned = np.einsum("nij,nj->ni", linear, self.mesh.normals[face])
        length = np.maximum(np.linalg.norm(turned, axis=1), 1e-300)
        return np.asarray(turned / -np.copysign(length, turned[:, 2])[:, None], np.float64)

    def close(self) -> None:
        """Release the device."""
        if self._device is not None:
            self._device.close()

    def _explained(self, placed: Array, patch: Patch) -> float:
        seen = self._rasterised(placed, len(patch.brightness))
        covered = seen.face >= 0
        normals = np.zeros((*covered.shape, 3), np.float32)
        normals[covered] = self.normals(placed, seen.face[covered])
        return explained(patch, normals, covered.astype(np.float32))

    def _rasterised(self, placed: Array, side: int) -> Visible:
        vertices = self.mesh.placed(placed)
        kept = drawable(vertices, self.mesh.faces, side, side)
        seen = rasterise(vertices[self.mesh.faces[kept]], side, side)
        face = np.where(seen.face >= 0, np.append(kept, -1)[seen.face], -1)
        return Visible(face, seen.depth)

    def _go_on_without(self, error: ScorerError) -> None:
        self._device = None
        warnings.warn(f"light and shade by NumPy from now on, slowly: {error}", RuntimeWarning, stacklevel=3)


class SunlitBodies:
    """Those of the last few models. Owned, used and closed by one thread."""

    def __init__(self, size: int) -> None:
        self._kept: Cache[SunlitBody] = Cache(size, lambda body: body.close())

    def of(self, model: str, mesh: Mesh) -> SunlitBody:
        """The body of a model, by its content key."""
        return self._kept.get(model, lambda: _open(mesh))

    def close(self) -> None:
        """Release every device."""
        self._kept.clear()


def in_patch(transforms: NDArray[np.floating], patch: Patch) -> Array:
    """(..., P, 3, 4) transforms to pixels of the image, as those to pixels of the patch."""
    placed = np.array(transforms, np.float64)
    placed[..., :2, 3] -= patch.origin
    return np.asarray(placed * patch.zoom)


def _open(mesh: Mesh) -> SunlitBody:
    try:
        return SunlitBody(mesh, open_sunlit(mesh, FIT))
    except DeviceError:  # of a CPU that fails or is missing the scorer tells, where it has no GPU
        return SunlitBody(mesh)

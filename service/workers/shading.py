"""Poses drawn with their normals, held against a frame's light and shade."""

from __future__ import annotations

from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from gpu.mesh import Mesh
from gpu.zbuffer import Visible, drawable, rasterise
from service.imaging.lighting import Alignment, View, align
from service.imaging.measurement import FrameMaps
from service.imaging.shading import Patch, cut_patch, explained
from service.inference.articulation import Articulation, part_transforms
from service.inference.islands import repeat
from service.inference.pose import retract
from service.inference.state import Array, Poses

FINE_PX = 128  # of the patch at most, where a pose is refined: edges between faces count to a share of a pixel
STEP = 1e-2  # tangent coordinates, for the slope of the parts' transforms
STEP_JOINT = 1.0


class Shading:
    """How well each pose's light and shade explain a frame, and which way it would do better: ``Shade``."""

    def __init__(self, mesh: Mesh, articulation: Articulation, maps: FrameMaps) -> None:
        self._mesh = mesh
        self._articulation = articulation
        self._maps = maps

    @cached_property
    def _coarse(self) -> Patch | None:
        return self._cut()

    @cached_property
    def _fine(self) -> Patch | None:
        return self._cut(FINE_PX)

    def _cut(self, *side_px: int) -> Patch | None:
        maps = self._maps
        if maps.brightness is None or maps.psf_sigma_px is None:
            return None
        return cut_patch(maps.brightness(), maps.log_ratio, maps.psf_sigma_px, *side_px)

    def __call__(self, poses: Poses) -> Array:
        """(N,) what ``explained`` says of each; 0 where the frame's light cannot be told from the sky's."""
        patch = self._coarse
        if patch is None:
            return np.zeros(len(poses))
        transforms = part_transforms(self._articulation, poses).astype(np.float64)
        drawn = (self._draw(one, patch) for one in transforms)
        return np.array([explained(patch, normals, (seen.face >= 0).astype(np.float32)) for normals, _, seen in drawn])

    def near(self, pose: Poses) -> Alignment | None:
        """What ``align`` says of one pose; None where the frame's light cannot be told, or the pose is not in it."""
        patch = self._fine
        if patch is None:
            return None
        d = 6 + pose.joints.shape[1]
        steps = np.diag([*np.full(3, STEP), 1.0, 1.0, STEP, *np.full(d - 6, STEP_JOINT)])
        beside = retract(repeat(pose, d), steps)
        transforms = part_transforms(self._articulation, pose).astype(np.float64)[0]
        slopes = part_transforms(self._articulation, beside).astype(np.float64) - transforms
        slopes /= np.diag(steps)[:, None, None, None]
        normals, face, seen = self._draw(transforms, patch)
        if len(face) == 0:
            return None
        part = np.searchsorted(np.cumsum([len(p.faces) for p in self._mesh.parts]), face, side="right")
        view = _view(transforms, slopes, normals, part, seen, patch, self._mesh.surfaces[face])
        return align(patch, view)

    def _draw(self, transforms: Array, patch: Patch) -> tuple[NDArray[np.float32], NDArray[np.int64], Visible]:
        """One pose in the patch: (S, S, 3) normals towards the camera, and the face of each pixel that sees one."""
        side, faces = len(patch.brightness), self._mesh.faces
        vertices = (self._mesh.placed(transforms) - [*patch.origin, 0.0]) * patch.zoom
        kept = drawable(vertices, faces, side, side)
        corners = vertices[faces[kept]]
        view = rasterise(corners, side, side)
        seen = view.face >= 0
        a, b, c = np.moveaxis(corners[view.face[seen]], 1, 0)
        across = np.cross(b - a, c - a)
        across /= -np.copysign(np.maximum(np.linalg.norm(across, axis=1), 1e-300), across[:, 2])[:, None]
        normals = np.zeros((side, side, 3), np.float32)
        normals[seen] = across
        return normals, kept[view.face[seen]], view


def _view(
    transforms: Array,
    slopes: Array,
    normals: NDArray[np.float32],
    part: NDArray[np.int64],
    seen: Visible,
    patch: Patch,
    surface: NDArray[np.int64],
) -> View:
    """A drawn pose and its motion: ``transforms`` (P, 3, 4), their ``slopes`` (d, P, 3, 4), ``part`` (n,)."""
    linear = slopes[..., :3] @ np.linalg.inv(transforms[..., :3])  # (d, P, 3, 3): camera to camera
    shift = slopes[..., 3] - np.einsum("dpij,pj->dpi", linear, transforms[..., 3])
    y, x = np.nonzero(seen.face >= 0)
    point = np.stack([x + 0.5, y + 0.5, seen.depth[y, x]], axis=1) / patch.zoom + [*patch.origin, 0.0]
    normal = normals[y, x].astype(np.float64)
    d, flow, turn = len(slopes), np.empty((len(slopes), len(x), 2)), np.empty((len(slopes), len(x), 3))
    for p in np.unique(part):
        of = np.flatnonzero(part == p)
        rows = linear[:, p].reshape(3 * d, 3).T  # one product for all coordinates
        moved = (point[of] @ rows).reshape(-1, d, 3)[..., :2] + shift[:, p, :2]
        flow[:, of] = np.swapaxes(patch.zoom * moved, 0, 1)
        turned = (normal[of] @ rows).reshape(-1, d, 3)
        along = turned @ normal[of][:, :, None]
        turn[:, of] = np.swapaxes(turned - along * normal[of][:, None], 0, 1)
    return View(y * len(patch.brightness) + x, normal, seen.depth[y, x], surface, flow, turn)

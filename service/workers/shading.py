"""Poses drawn with their normals, held against a frame's light and shade."""

from __future__ import annotations

from functools import cached_property

import numpy as np

from gpu.zbuffer import Visible
from service.imaging.lighting import Alignment, View, align
from service.imaging.measurement import FrameMaps
from service.imaging.shading import MARGIN, SIDE_PX, Patch, cut_patch
from service.inference.articulation import Articulation, part_transforms
from service.inference.islands import repeat
from service.inference.pose import retract
from service.inference.state import Array, Poses
from service.workers.sunlit import SunlitBody

FINE_PX = 104  # of the patch at most, where a pose is refined: edges between faces count to a share of a pixel
FINE_MARGIN = 0.1
STEP = 1e-2  # tangent coordinates, for the slope of the parts' transforms
STEP_JOINT = 1.0


class Shading:
    """How well each pose's light and shade explain a frame, and which way it would do better: ``Shade``."""

    def __init__(self, body: SunlitBody, articulation: Articulation, maps: FrameMaps) -> None:
        self._body = body
        self._articulation = articulation
        self._maps = maps

    @cached_property
    def _coarse(self) -> Patch | None:
        return self._cut()

    @cached_property
    def _fine(self) -> Patch | None:
        return self._cut(FINE_PX, FINE_MARGIN)

    def _cut(self, side_px: int = SIDE_PX, margin: float = MARGIN) -> Patch | None:
        maps = self._maps
        if maps.brightness is None or maps.psf_sigma_px is None:
            return None
        return cut_patch(maps.brightness(), maps.log_ratio, maps.psf_sigma_px, side_px, margin)

    def __call__(self, poses: Poses) -> Array:
        """(N,) what ``explained`` says of each; 0 where the frame's light cannot be told from the sky's."""
        patch = self._coarse
        if patch is None:
            return np.zeros(len(poses))
        return self._body.explained(part_transforms(self._articulation, poses), patch)

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
        seen = self._body.draw(transforms, patch)
        return align(patch, self._view(transforms, slopes, seen, patch)) if (seen.face >= 0).any() else None

    def _view(self, transforms: Array, slopes: Array, seen: Visible, patch: Patch) -> View:
        """A drawn pose and its motion: ``transforms`` (P, 3, 4) and their ``slopes`` (d, P, 3, 4)."""
        linear = slopes[..., :3] @ np.linalg.inv(transforms[..., :3])  # (d, P, 3, 3): camera to camera
        origin = np.array([*patch.origin, 0.0])
        shift = slopes[..., 3] - np.einsum("dpij,pj->dpi", linear, transforms[..., 3] - origin)
        y, x = np.nonzero(seen.face >= 0)
        face, depth = seen.face[y, x], seen.depth[y, x]
        point = np.stack([x + 0.5, y + 0.5, depth], axis=1).astype(np.float32) / np.float32(patch.zoom)
        normal = self._body.normals(transforms, face)
        d, n = len(slopes), len(x)
        flow, turn = np.empty((d, n, 2), np.float32), np.empty((d, n, 3), np.float32)
        every = np.concatenate([transforms[None], slopes]).swapaxes(0, 1).reshape(len(transforms), -1)
        _, first, alike = np.unique(every, axis=0, return_index=True, return_inverse=True)
        together = alike.ravel()[self._body.mesh.part_of[face]]  # parts that no joint moves apart go as one
        for k, p in enumerate(first):
            of = np.flatnonzero(together == k)
            across = np.swapaxes(linear[:, p], 1, 2).astype(np.float32)
            moved = point[of] @ across[..., :2] + shift[:, p, None, :2].astype(np.float32)
            flow[:, of] = np.float32(patch.zoom) * moved
            facing = normal[of].astype(np.float32)
            turned = facing @ across
            turn[:, of] = turned - np.einsum("dnk,nk->dn", turned, facing)[..., None] * facing
        return View(y * len(patch.brightness) + x, normal, depth, self._body.mesh.surfaces[face], flow, turn)

"""Poses drawn with their normals, held against a frame's light and shade."""

from __future__ import annotations

from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from gpu.mesh import Mesh
from gpu.zbuffer import drawable, rasterise
from service.imaging.measurement import FrameMaps
from service.imaging.shading import Patch, cut_patch, explained
from service.inference.articulation import Articulation, part_transforms
from service.inference.state import Array, Poses


class Shading:
    """How well each pose's light and shade explain a frame: ``shade`` of ``inference.step``."""

    def __init__(self, mesh: Mesh, articulation: Articulation, maps: FrameMaps) -> None:
        self._mesh = mesh
        self._articulation = articulation
        self._maps = maps

    @cached_property
    def _patch(self) -> Patch | None:
        """Cut when it is first asked for: a frame that follows its track needs none."""
        maps = self._maps
        if maps.brightness is None or maps.psf_sigma_px is None:
            return None
        return cut_patch(maps.brightness(), maps.log_ratio, maps.psf_sigma_px)

    def __call__(self, poses: Poses) -> Array:
        """(N,) what ``explained`` says of each; 0 where the frame's light cannot be told from the sky's."""
        patch = self._patch
        if patch is None:
            return np.zeros(len(poses))
        transforms = part_transforms(self._articulation, poses).astype(np.float64)
        return np.array([explained(patch, *self._draw(one, patch)) for one in transforms])

    def _draw(self, transforms: Array, patch: Patch) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """(S, S, 3) normals towards the camera and (S, S) coverage of one pose, in the patch."""
        side, faces = len(patch.brightness), self._mesh.faces
        vertices = (self._mesh.placed(transforms) - [*patch.origin, 0.0]) * patch.zoom
        corners = vertices[faces[drawable(vertices, faces, side, side)]]
        face = rasterise(corners, side, side).face
        seen = face >= 0
        a, b, c = np.moveaxis(corners[face[seen]], 1, 0)
        across = np.cross(b - a, c - a)
        across /= -np.copysign(np.maximum(np.linalg.norm(across, axis=1), 1e-300), across[:, 2])[:, None]
        normals = np.zeros((side, side, 3), np.float32)
        normals[seen] = across
        return normals, seen.astype(np.float32)

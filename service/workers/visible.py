"""How much of a silhouette lies in the image: the paper's prior holds only poses that show at least half."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from gpu.mesh import Mesh
from service.inference.articulation import part_transforms
from service.inference.state import Array, Poses
from service.workers.scoring import TimedScorer


class HalfShown:
    """``Domain.shows_half``: a silhouette's pixels within the (H, W) image, against those of the whole of it.

    Only what may reach over a border is drawn: in its place, and once more in the middle, no larger than the image.
    """

    def __init__(self, scorer: TimedScorer, mesh: Mesh, shape: tuple[int, int]) -> None:
        self._scorer, self._shape = scorer, shape
        boxes = [(part.vertices.min(axis=0), part.vertices.max(axis=0)) for part in mesh.parts]
        self._centres = np.array([(low + high) / 2 for low, high in boxes])  # (P, 3) of balls about the parts
        reaches = zip(mesh.parts, self._centres, strict=True)
        self._radii = np.array([np.linalg.norm(part.vertices - centre, axis=1).max() for part, centre in reaches])

    def __call__(self, poses: Poses) -> NDArray[np.bool_]:
        """(N,) which show at least half."""
        return np.concatenate([self._of(batch) for batch in self._scorer.batches(poses)])

    def _of(self, poses: Poses) -> NDArray[np.bool_]:
        transforms = part_transforms(self._scorer.articulation, poses)
        low, high = self._boxes(transforms, np.exp(poses.log_scale))
        size = np.array(self._shape[::-1])
        shown: NDArray[np.bool_] = np.all((low >= 0) & (high <= size), axis=1)
        crossing = np.flatnonzero(~shown)
        if not len(crossing):
            return shown
        middle, extent = (low + high)[crossing] / 2, (high - low)[crossing]
        shrunk = 1 / np.maximum((extent / size).max(axis=1), 1.0)  # (n,)
        whole = transforms[crossing] * shrunk[:, None, None, None].astype(np.float32)
        whole[:, :, :2, 3] += (size / 2 - shrunk[:, None] * middle)[:, None]
        ones = _ones(self._shape)
        pixels = self._scorer.sums(transforms[crossing], ones) * shrunk**2
        shown[crossing] = pixels >= self._scorer.sums(whole, ones) / 2
        return shown

    def _boxes(self, transforms: NDArray[np.float32], scale: Array) -> tuple[Array, Array]:
        """(N, 2) least and greatest x and y that a silhouette can reach, px."""
        centres = np.einsum("npij,pj->npi", transforms[:, :, :2, :3], self._centres) + transforms[:, :, :2, 3]
        radii = (scale[:, None] * self._radii)[:, :, None]
        return (centres - radii).min(axis=1), (centres + radii).max(axis=1)


@lru_cache(maxsize=4)
def _ones(shape: tuple[int, int]) -> NDArray[np.float32]:
    """(H, W) the map under which a score is a number of pixels; read-only, so that scorers know it again."""
    ones = np.ones(shape, np.float32)
    ones.flags.writeable = False
    return ones

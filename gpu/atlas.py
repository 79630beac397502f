"""Where each particle of a batch is drawn: tiles just large enough, side by side in one texture."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gpu.mesh import Mesh

LANES = 16
SIDE = 4096  # of the atlas, where a tile does not need more


@dataclass(frozen=True)
class Tiles:
    """Tiles of one size for N particles, and where in the image each has its corner."""

    width: int  # a multiple of LANES
    height: int
    origins: NDArray[np.int32]  # (N, 2) x, y in pixels of the image
    clipped: bool  # some silhouette may reach beyond its tile

    def across(self, atlas_width: int) -> int:
        """Tiles in a row of the atlas."""
        return atlas_width // self.width

    def capacity(self, atlas: tuple[int, int]) -> int:
        """Tiles in an atlas of this width and height."""
        return (atlas[0] // self.width) * (atlas[1] // self.height)


class Bounds:
    """Spheres around the parts, from which follows what each particle can cover."""

    def __init__(self, mesh: Mesh) -> None:
        boxes = [(part.vertices.min(axis=0), part.vertices.max(axis=0)) for part in mesh.parts]
        self._centres = np.array([0.5 * (low + high) for low, high in boxes])  # (P, 3)
        self._radii = np.array(
            [
                np.linalg.norm(part.vertices - centre, axis=1).max()
                for part, centre in zip(mesh.parts, self._centres, strict=True)
            ]
        )

    def tiles(self, transforms: NDArray[np.float32], shape: tuple[int, int]) -> Tiles:
        """The smallest common tile for (N, P, 3, 4) transforms in an image of (H, W)."""
        size = np.array([shape[1], shape[0]], dtype=np.float64)
        rows = np.asarray(transforms[:, :, :2], dtype=np.float64)
        centre = np.einsum("npij,pj->npi", rows[..., :3], self._centres) + rows[..., 3]
        reach = np.linalg.norm(rows[..., :3], axis=-1) * self._radii[:, None] + 1.0
        first = np.nan_to_num(np.floor((centre - reach).min(axis=1)))
        end = np.nan_to_num(np.ceil((centre + reach).max(axis=1)))
        low, high = np.clip(first, 0, size), np.clip(end, 0, size)
        needed = np.maximum((high - low).max(axis=0, initial=1.0), 1.0).astype(int)
        width = -(-int(needed[0]) // LANES) * LANES
        height = int(needed[1])
        last = np.maximum(size - (width, height), 0)
        clipped = bool((first < low).any() or (end > high).any())
        return Tiles(width, height, np.minimum(low, last).astype(np.int32), clipped)


def atlas_size(tiles: Tiles, n: int, largest_side: int) -> tuple[int, int]:
    """Width and height of an atlas for up to n tiles: at most ``SIDE`` a side unless a single tile is larger."""
    width = min(max(SIDE // tiles.width * tiles.width, tiles.width), largest_side)
    rows = min(-(-n // tiles.across(width)), max(1, SIDE // tiles.height))
    return width, min(rows * tiles.height, largest_side)

"""Silhouettes for the overlap: drawn four times finer than the image, outlines included.

Not the scorer's rule (a pixel counts if its centre is covered): the benchmark's own, so that figures of other
programs and of this one are alike. Thin struts come out thicker by a part of a fine pixel, in truth and answer both.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from gpu.mesh import Mesh
from service.inference.articulation import Articulation, part_transforms
from service.inference.state import Poses

FINER = 4
_SUBPIXEL_BITS = 4

Mask = NDArray[np.bool_]


def fine_silhouette(mesh: Mesh, articulation: Articulation, pose: Poses, size: tuple[int, int]) -> Mask:
    """(FINER H, FINER W) what the body at a pose (a batch of one) covers in an image of ``size`` (width, height)."""
    mask = np.zeros((size[1] * FINER, size[0] * FINER), np.uint8)
    for part, matrix in zip(mesh.parts, part_transforms(articulation, pose)[0].astype(np.float64), strict=True):
        projected = part.vertices @ matrix[:2, :3].T + matrix[:2, 3]
        corners = np.round((projected * FINER - 0.5) * (1 << _SUBPIXEL_BITS)).astype(np.int32)[part.faces]
        for triangle in corners:
            cv2.fillConvexPoly(mask, triangle, 1, shift=_SUBPIXEL_BITS)
    return mask.astype(np.bool_)


def overlap(a: Mask, b: Mask) -> float:
    """Intersection over union of two masks."""
    return float((a & b).sum()) / max(1, int((a | b).sum()))


def whole_pixels(fine: Mask) -> Mask:
    """(H, W) pixels that a fine mask covers for the greater part."""
    height, width = fine.shape[0] // FINER, fine.shape[1] // FINER
    share = fine.reshape(height, FINER, width, FINER).mean(axis=(1, 3))
    return np.asarray(share > 0.5)

"""What a user would write with OpenCV: particle by particle, draw the faces into a mask, sum the map under it."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from gpu.bench import Contestant
from gpu.looping import Floats, LoopingScorer, Map, Transforms
from gpu.mesh import Mesh
from gpu.reference import project

NAME = "opencv"
FRACTION_BITS = 6  # of OpenCV's fixed-point coordinates


class OpenCvLoop(LoopingScorer):
    """Draws each face with ``cv2.fillConvexPoly``, of a closed mesh only those that are turned to the camera.

    (``cv2.fillPoly`` and ``cv2.drawContours`` with all faces at once leave holes where two of them overlap.)
    OpenCV also paints the pixels that an edge runs through.
    """

    name = f"opencv:{cv2.__version__}"

    def __init__(self, mesh: Mesh) -> None:
        self._mesh = mesh

    def score(self, part_transforms: Transforms, log_ratio: Map) -> Floats:
        """(N, P, 3, 4) transforms, (H, W) map -> (N,) sums of the map under the silhouettes."""
        return np.array([self._score_one(transforms, log_ratio) for transforms in part_transforms])

    def close(self) -> None:
        """Nothing to release."""

    def _score_one(self, transforms: Transforms, log_ratio: Map) -> float:
        mask = np.zeros(log_ratio.shape, np.uint8)
        for part, transform in zip(self._mesh.parts, transforms, strict=True):
            corners = project(part, transform)[part.faces]  # (F, 3, 2)
            if self._mesh.watertight:
                corners = corners[_towards_camera(corners)]
            # OpenCV's pixel centres lie on whole numbers.
            fixed = np.rint((corners - 0.5) * (1 << FRACTION_BITS)).astype(np.int32)
            for triangle in fixed:
                cv2.fillConvexPoly(mask, triangle, 1, shift=FRACTION_BITS)
        return float(cv2.mean(log_ratio, mask)[0]) * cv2.countNonZero(mask)


def opencv_contestant() -> Contestant:
    """The loop, as a scorer among the others."""
    return Contestant(NAME, OpenCvLoop, draws_edges=True)


def _towards_camera(corners: NDArray[np.float32]) -> NDArray[np.bool_]:
    """(F, 3, 2) -> (F,) faces seen from outside: y runs down and z away, so they turn clockwise to the eye."""
    a, b = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    return np.asarray(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0] < 0)

"""What an outline is worth on a frame of clutter: the paper's Eq. 4, both densities learnt, and what its rim shows."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from service.inference.model.drawing import EVEN_PLANES, Drawing, Images, Quality, View
from service.inference.model.prior import CLUTTER_ALIKE_PX, RIM_ALIKE_PX, RIM_UNSEEN
from service.inference.state import Array, Poses

_OUTLINE = Quality(supersample=2, shadow_px=0, gloss=())  # numerical: no light is drawn
_TOWARDS_SUN = np.array([0.0, 0.0, -1.0])  # exact: outlines cast no shadow
_BATCH_PX = 1 << 21  # numerical: of pictures at once


@dataclass(frozen=True)
class Outlook:
    """A frame's log c on a patch, and its slopes."""

    drawing: Drawing
    view: View
    log_ratio: Images  # (S, S) means over patch px
    slopes: Images  # (3, S, S) squares xx, xy, yy, summed over channels, in units of the mean slope's square

    def covered(self, poses: Poses) -> Images:
        """(N, S, S) share of a patch px that is covered."""
        even = np.zeros(self.drawing.n_groups + EVEN_PLANES, np.float32)
        even[self.drawing.n_groups] = 1.0
        return self.drawing.combined(poses, _TOWARDS_SUN, even, self.view, _OUTLINE)

    def score(self, poses: Poses) -> Array:
        """(N,) nats: the sum of log c under each silhouette, and of what its rim shows; as much counts as one as is
        alike.
        """
        size = max(1, _BATCH_PX // self.view.side**2)
        parts = [self._score(self.covered(poses[slice(k, k + size)])) for k in range(0, len(poses), size)]
        return np.concatenate(parts)

    def _score(self, covered: Images) -> Array:
        area = np.einsum("nij,ij->n", covered, self.log_ratio, optimize=True).astype(np.float64)
        rim = _Rim.of(covered)
        along = np.bincount(rim.pose, weights=rim.length * self._shown(rim), minlength=len(covered))
        binning = self.view.binning
        return np.asarray(area * (binning / CLUTTER_ALIKE_PX) ** 2 + along * (binning / RIM_ALIKE_PX))

    def rims(self, covered: Images) -> Array:
        """(N,) lengths of the rims of silhouettes (N, S, S), patch px."""
        rim = _Rim.of(covered)
        return np.asarray(np.bincount(rim.pose, weights=rim.length, minlength=len(covered)), np.float64)

    def _shown(self, rim: _Rim) -> Array:
        """(M,) log of how likely the slope across a rim is, over how likely it is anywhere.

        The share of all slopes that are less is alike for all of them anywhere, and grows as its square at a rim, but
        for rims that no light tells from what is behind them.
        """
        xx, xy, yy = self.slopes.reshape(3, -1)[:, rim.place]
        x, y = rim.across, rim.down
        slope = np.sqrt(np.maximum(xx * x * x + 2 * xy * x * y + yy * y * y, 0)) / rim.length
        less = 1 - np.exp(-slope)
        return np.asarray(np.log(RIM_UNSEEN + (1 - RIM_UNSEEN) * 3 * less**2))


@dataclass(frozen=True)
class _Rim:
    """Where coverage changes: M pixels."""

    pose: NDArray[np.intp]
    place: NDArray[np.intp]  # in its picture
    across: Array  # slope of the coverage
    down: Array

    @staticmethod
    def of(covered: Images) -> _Rim:
        """Of N silhouettes (N, S, S)."""
        side, flat = covered.shape[2], np.ascontiguousarray(covered).ravel()
        changes = covered[:, 1:-1, 2:] != covered[:, 1:-1, :-2]
        changes |= covered[:, 2:, 1:-1] != covered[:, :-2, 1:-1]
        pose, inner = np.divmod(np.flatnonzero(changes), (side - 2) ** 2)
        row, column = np.divmod(inner, side - 2)
        place = (row + 1) * side + column + 1
        at = pose * side**2 + place
        return _Rim(pose, place, 0.5 * (flat[at + 1] - flat[at - 1]), 0.5 * (flat[at + side] - flat[at - side]))

    @property
    def length(self) -> Array:
        """(M,) of the rim in each, patch px."""
        return np.asarray(np.hypot(self.across, self.down))

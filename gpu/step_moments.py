"""Eq. 5 out of the sums that the device made."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from gpu.step_arrays import Floats


@dataclass(frozen=True)
class Mean:
    """The expected pose, and what the weights alone say."""

    rotation: Rotation
    position: Floats  # (2,) px
    scale: float
    joints: Floats  # (J,)
    total: float  # sum of the weights, the heaviest of which is 1
    ess: float

    def numbers(self) -> Floats:
        """(7 + J,) quaternion x, y, z, w, then x, y, log scale, joints: as the kernel reads it."""
        return np.concatenate([self.rotation.as_quat(), self.position, [np.log(self.scale)], self.joints])


@dataclass(frozen=True)
class Spread:
    """Second moments about a mean."""

    covariance: Floats  # (6 + J, 6 + J)
    scale_deviation: float


def mean_of(sums: Floats, low: Floats, period: Floats) -> Mean:
    """The mean pose of the sums in ``sums_for_mean``; the rotation is the chordal mean (Markley et al. 2007).

    Joints with a ``period`` (3 + J,) are averaged on their circle and told from ``low`` (3 + J,) on.
    """
    total, squares = sums[:2]
    x, y, scale = sums[2:5] / total
    n_joints = len(period) - 3
    linear, cosine, sine = sums[5 : 5 + 3 * n_joints].reshape(n_joints, 3).T
    circular = np.rad2deg(np.arctan2(sine, cosine))
    moment = _symmetric(sums[5 + 3 * n_joints :], 4)
    return Mean(
        rotation=Rotation.from_quat(np.linalg.eigh(moment)[1][:, -1]),
        position=np.array([x, y]),
        scale=float(scale),
        joints=np.where(period[3:] > 0, low[3:] + np.mod(circular - low[3:], 360.0), linear / total),
        total=float(total),
        ess=float(total * total / squares),
    )


def spread_of(sums: Floats, total: float, dimension: int) -> Spread:
    """The spread of the sums in ``sums_for_spread``; ``dimension`` is 6 + J."""
    return Spread(
        covariance=_symmetric(sums[:-1], dimension) / total,
        scale_deviation=float(np.sqrt(sums[-1] / total)),
    )


def _symmetric(upper: Floats, size: int) -> Floats:
    """The matrix whose upper triangle, row by row, is given."""
    matrix = np.zeros((size, size))
    matrix[np.triu_indices(size)] = upper
    return matrix + np.triu(matrix, 1).T

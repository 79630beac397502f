"""The angular velocity that goes with a reported pose."""

from __future__ import annotations

import numpy as np

from service.inference.pose import angle_between
from service.inference.state import Array, FilterState

_NEAR_RAD = float(np.deg2rad(15.0))  # shown: particles so near to the best are of its rate


def rotation_rate(state: FilterState, quaternion: Array) -> Array | None:
    """(3,) weighted mean rotation rate, rad/s in body axes, of the particles within 15 degrees of ``quaternion``.

    Not of all: particles of different modes turn about different axes of the body, and their mean is none of them.
    None where no particle is near.
    """
    near = angle_between(state.poses.quaternion, quaternion) < _NEAR_RAD
    weights = np.where(near, np.exp(state.log_weights), 0.0)
    total = float(np.sum(weights))
    if total <= 0.0:
        return None
    return np.asarray(weights @ state.rates[:, :3] / total, dtype=np.float64)

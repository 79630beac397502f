"""An attitude mode that was told: how likely an orientation is in the frame that holds the body (docs/attitude.md)."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from service.inference.pose import conjugate, multiply
from service.inference.spin.alignment import ALIGNED, log_aligned_or_any, log_axis_along_z
from service.inference.spin.frames import LOG_UNIFORM
from service.inference.state import Array, Mixture

HeldMode = Literal["nadir_pointing", "yaw_steering", "sun_pointing"]


@dataclass(frozen=True)
class Held:
    """What a session was told, at one frame."""

    mode: HeldMode
    reference: tuple[float, float, float, float]  # the frame that holds the body -> camera, as poses count its axes

    def log_ratio(self, quaternion: Array) -> Array:
        """(N,) log density of orientations body -> camera (N, 4) over that of one that may be any.

        One half is within 5 degrees (sigma, each axis) of an alignment; the other half is any: what was told may be
        wrong.
        """
        held = multiply(conjugate(np.array(self.reference)), quaternion)
        if self.mode == "sun_pointing":
            told = np.logaddexp(np.log(ALIGNED) + log_axis_along_z(held), np.log(1 - ALIGNED) + LOG_UNIFORM)
        else:
            told = log_aligned_or_any(held)
        return np.asarray(told - LOG_UNIFORM)


def believed(mixture: Mixture, held: Held | None) -> Mixture:
    """Modes weighed with what was told. What is carried on is not: the prior counts once, in every answer."""
    if held is None:
        return mixture
    log_weights = mixture.log_weights + held.log_ratio(mixture.poses.quaternion)
    return replace(mixture, log_weights=log_weights - np.logaddexp.reduce(log_weights))

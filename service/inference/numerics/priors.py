"""What is known of poses beside a frame."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from service.inference.estimate import tangent
from service.inference.model.prior import LightPrior
from service.inference.model.sun_tracking import SunTracking
from service.inference.state import Array, Poses


@dataclass(frozen=True)
class PosePrior:
    """What is known of a pose beside the frame."""

    log_scale: float | None = None
    log_scale_sigma: float = 0.03
    towards_sun: Array | None = None  # (3,) unit
    sun_sigma: float = 0.0175  # rad
    tracking: SunTracking | None = None  # joints that turn panels towards the Sun
    light: LightPrior = field(default_factory=LightPrior)


@dataclass(frozen=True)
class Believed:
    """What earlier frames say of each of N poses, Gaussians in the tangent space of their means, and of its paint."""

    means: Poses
    precision: Array  # (N, 6 + J, 6 + J)
    wrapping: NDArray[np.bool_]  # (J,) joints that turn all the way round
    paint: Array  # (N, 2, P) see ``model.paint``
    suns: Array  # (N, 3) unit; they count where the Sun is not told
    sun_precision: Array  # (N,) rad^-2, each axis

    def away(self, poses: Poses, at: NDArray[np.intp]) -> Array:
        """(n, 6 + J) from the means to the poses that are numbered ``at``; turning joints the short way round."""
        return tangent(self.means[at], poses, self.wrapping)

    def log_density(self, poses: Poses, at: NDArray[np.intp]) -> Array:
        """(n,) of them, but for the Gaussians' heights."""
        away = self.away(poses, at)
        return np.asarray(-0.5 * np.einsum("ni,nij,nj->n", away, self.precision[at], away))

    def log_density_of_sun(self, suns: Array, at: NDArray[np.intp]) -> Array:
        """(n,) of the Sun that goes with each pose, but for the Gaussians' heights."""
        return np.asarray(-0.5 * self.sun_precision[at] * np.sum((suns - self.suns[at]) ** 2, axis=1))

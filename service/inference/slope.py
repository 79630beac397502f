"""What light and shade say of the poses near one: to second order, so that every particle can be asked."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from service.inference.modes import Metric, distance
from service.inference.pose import local
from service.inference.state import Array, Poses


@dataclass(frozen=True)
class Slope:
    """How what a shaded body leaves over of the brightness changes near ``pose``, as a log-likelihood in nats.

    The brightness left over rises with the square of the distance from where it is least, and its log is what counts:
    -``nats`` log(1 + (x - x0)' H (x - x0) / 2 nats), H the ``curvature`` and H x0 the ``gradient``.
    """

    pose: Poses  # one
    gradient: Array  # (d,) at ``pose``
    curvature: Array  # (d, d), positive semi-definite
    nats: float

    @cached_property
    def least(self) -> Array:
        """(d,) tangent coordinates of the best pose, as far as light and shade tell any."""
        diagonal = np.diag(self.curvature)
        unit = 1.0 / np.sqrt(np.where(diagonal > 0, diagonal, 1.0))  # radians, pixels and a joint's degrees made alike
        alike = np.linalg.pinv(unit[:, None] * self.curvature * unit, rcond=1e-6, hermitian=True)
        return np.asarray(unit * (alike @ (unit * self.gradient)), np.float64)

    def __call__(self, poses: Poses) -> Array:
        """(N,) nats, 0 at the best pose."""
        x = local(self.pose, poses) - self.least
        return np.asarray(-self.nats * np.log1p(np.einsum("ni,ij,nj->n", x, self.curvature, x) / (2 * self.nats)))


def sloped(slopes: Sequence[Slope], poses: Poses, metric: Metric) -> Array:
    """(N,) what the slopes say of poses: the nearest one of those in the same mode, 0 where there is none."""
    out, nearest = np.zeros(len(poses)), np.ones(len(poses))
    for slope in slopes:
        gap = distance(poses, slope.pose, metric)
        mine = gap <= nearest
        if mine.any():
            out[mine], nearest[mine] = slope(poses[mine]), gap[mine]
    return out

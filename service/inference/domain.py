"""The space a pose lives in: image, body size, joint ranges, and the uniform prior over it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from service.inference.articulation import Articulation
from service.inference.params import PriorParams
from service.inference.state import Array, Poses


@dataclass(frozen=True)
class Domain:
    """Bounds of the uniform prior (the paper's section 2).

    The body's diameter spans at least ``min_extent`` of the image's shorter side and at most ``max_extent`` of the
    longer one, and its centre lies in the image: nine draws in ten then show at least half of it, as the paper asks of
    all. Where the range is known, ``scale_within`` says more than the extents.
    """

    width: int
    height: int
    radius: float  # of the body, model units
    articulation: Articulation
    prior: PriorParams
    scale_within: tuple[float, float] | None = None  # px per model unit: known bounds, in the place of the extents

    @property
    def n_tangent(self) -> int:
        """Dimension of the tangent space, 6 + J."""
        return 6 + self.articulation.n_joints

    @property
    def log_scale_bounds(self) -> tuple[float, float]:
        """Least and greatest log scale (log of px per model unit)."""
        if self.scale_within is not None:
            return float(np.log(self.scale_within[0])), float(np.log(self.scale_within[1]))
        side = min(self.width, self.height)
        return (
            float(np.log(self.prior.min_extent * side / (2 * self.radius))),
            float(np.log(self.prior.max_extent * max(self.width, self.height) / (2 * self.radius))),
        )

    @property
    def joint_bounds(self) -> tuple[Array, Array]:
        """(J,) least and greatest joint values."""
        joints = self.articulation.joints
        return np.array([j.minimum for j in joints]), np.array([j.maximum for j in joints])

    @property
    def log_volume(self) -> float:
        """Log of the volume of all poses in tangent units: the uniform prior's density is its inverse."""
        low, high = self.log_scale_bounds
        least, greatest = self.joint_bounds
        sizes = np.array([8 * np.pi**2, self.width, self.height, high - low, *(greatest - least)])
        return float(np.sum(np.log(sizes)))

    @property
    def wrapping(self) -> NDArray[np.bool_]:
        """(J,) joints that turn all the way round."""
        return np.array([j.kind == "revolute" and j.maximum - j.minimum >= 360 for j in self.articulation.joints], bool)

    def contains(self, poses: Poses) -> NDArray[np.bool_]:
        """(N,) which poses lie within the prior's bounds."""
        low, high = self.log_scale_bounds
        least, greatest = self.joint_bounds
        inside = (poses.log_scale >= low) & (poses.log_scale <= high)
        inside &= np.all((poses.position >= 0) & (poses.position <= (self.width, self.height)), axis=1)
        within = (poses.joints >= least) & (poses.joints <= greatest)
        return np.asarray(inside & np.all(within | self.wrapping, axis=1))

    def wrap(self, poses: Poses) -> Poses:
        """Bring joints that turn all the way round back into their range."""
        if not np.any(self.wrapping):
            return poses
        least, _ = self.joint_bounds
        turned = least + np.mod(poses.joints - least, 360.0)
        joints = np.where(self.wrapping, turned, poses.joints)
        return Poses(poses.quaternion, poses.position, poses.log_scale, joints)


def sample_prior(rng: np.random.Generator, domain: Domain, count: int) -> Poses:
    """The uniform prior: rotation uniform on SO(3), scale, position and joints uniform within their bounds."""
    low, high = domain.log_scale_bounds
    least, greatest = domain.joint_bounds
    quaternion = rng.standard_normal((count, 4))
    return Poses(
        quaternion / np.linalg.norm(quaternion, axis=1, keepdims=True),
        rng.random((count, 2)) * (domain.width, domain.height),
        np.log(rng.uniform(np.exp(low), np.exp(high), count)),
        least + rng.random((count, domain.articulation.n_joints)) * (greatest - least),
    )

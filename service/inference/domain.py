"""The space a pose lives in: image, body size, joint ranges, and the uniform prior over it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from service.inference.articulation import Articulation
from service.inference.params import PriorParams
from service.inference.pose import any_turns, concatenate
from service.inference.state import Array, Poses

ShowsHalf = Callable[[Poses], NDArray[np.bool_]]  # (N,) which poses show at least half of the body in the image
_ROUNDS = 100  # numerical: of drawing, of which each accepts a fifth or more unless the body is larger than the image


@dataclass(frozen=True)
class Domain:
    """Bounds of the uniform prior (the paper's section 2).

    The body's diameter spans at least ``min_extent`` of the image's shorter side and at most ``max_extent`` of the
    longer one. At least half of the body is in the image, as the paper asks, where ``shows_half`` can tell; where it is
    None, the body's centre is. Where the range is known, ``scale_within`` says more than the extents.
    """

    width: int
    height: int
    radius: float  # of the body, model units
    articulation: Articulation
    prior: PriorParams
    scale_within: tuple[float, float] | None = None  # px per model unit: known bounds, in the place of the extents
    shows_half: ShowsHalf | None = field(default=None, repr=False, compare=False)

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
    def position_bounds(self) -> tuple[Array, Array]:
        """(2,) least and greatest x and y of the body's centre, px.

        Half of a lopsided body can be seen while its centre is outside: by its largest radius at most, and by no more
        than the image's longer side.
        """
        largest = min(self.radius * float(np.exp(self.log_scale_bounds[1])), max(self.width, self.height))
        reach = 0.0 if self.shows_half is None else largest
        return np.full(2, -reach), np.array([self.width, self.height]) + reach

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
        return self.articulation.wrapping

    def contains(self, poses: Poses) -> NDArray[np.bool_]:
        """(N,) which poses lie within the bounds of each coordinate."""
        low, high = self.log_scale_bounds
        least, greatest = self.joint_bounds
        first, last = self.position_bounds
        inside = (poses.log_scale >= low) & (poses.log_scale <= high)
        inside &= np.all((poses.position >= first) & (poses.position <= last), axis=1)
        within = (poses.joints >= least) & (poses.joints <= greatest)
        return np.asarray(inside & np.all(within | self.wrapping, axis=1))

    def stays(self, moved: Poses, before: Poses) -> NDArray[np.bool_]:
        """(N,) which moves do not leave the prior: a body of which half was not seen before may be moved anywhere."""
        made = self.contains(moved)
        if self.shows_half is not None:
            unseen = np.flatnonzero(made)[~self.shows_half(moved[made])]
            made[unseen] = ~self.shows_half(before[unseen])
        return made

    def wrap(self, poses: Poses) -> Poses:
        """Bring joints that turn all the way round back into their range."""
        if not np.any(self.wrapping):
            return poses
        least, _ = self.joint_bounds
        turned = least + np.mod(poses.joints - least, 360.0)
        joints = np.where(self.wrapping, turned, poses.joints)
        return Poses(poses.quaternion, poses.position, poses.log_scale, joints)


def sample_prior(rng: np.random.Generator, domain: Domain, count: int) -> Poses:
    """The uniform prior over all poses within the bounds; rotation uniform on SO(3).

    A body too large to be shown by half anywhere is drawn within the bounds of its coordinates alone.
    """
    if domain.shows_half is None:
        return _sample_bounds(rng, domain, count)
    found: list[Poses] = []
    for _ in range(_ROUNDS):
        drawn = _sample_bounds(rng, domain, count)
        found.append(drawn[domain.shows_half(drawn)])
        if sum(map(len, found)) >= count:
            break
    return concatenate(*found, drawn)[slice(count)]


def _sample_bounds(rng: np.random.Generator, domain: Domain, count: int) -> Poses:
    """Each coordinate uniform within its bounds, the scale itself and not its log."""
    low, high = domain.log_scale_bounds
    first, last = domain.position_bounds
    least, greatest = domain.joint_bounds
    return Poses(
        any_turns(rng, count),
        first + rng.random((count, 2)) * (last - first),
        np.log(rng.uniform(np.exp(low), np.exp(high), count)),
        least + rng.random((count, domain.articulation.n_joints)) * (greatest - least),
    )

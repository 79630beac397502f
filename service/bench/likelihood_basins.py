"""Which basins are the truth's, which are its mirror twins, and by how much one beats another."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from service.bench.cases import Case
from service.bench.scoring import ambiguity
from service.inference.articulation import Articulation
from service.inference.model.prior import POSE_DEGREES_OF_FREEDOM
from service.inference.numerics.student import squared_radius
from service.inference.pose import angle_between, concatenate, local
from service.inference.state import Array, Poses
from service.inference.symmetry import Symmetry, twin

NEAR_DEG = 5.0
"""A basin this near to a pose is that pose's."""
REGION_50, REGION_90 = (squared_radius(share, 3, POSE_DEGREES_OF_FREEDOM) for share in (0.5, 0.9))
"""What a rotation error's square in units of the stated covariance stays below."""


@dataclass(frozen=True)
class Likeness:
    """The poses that look like the truth: its rotation symmetries are the truth, its mirror twins are not."""

    truths: Poses  # the truth first
    twins: Poses | None  # None: the body has no mirror plane

    @staticmethod
    def of(case: Case, held: Articulation, truth: Poses) -> Likeness:
        """Of one true pose. Symmetries of joints alone count for nothing."""
        found = ambiguity(case, held)
        turned = [twin(truth, symmetry) for symmetry in _of_kind(found, "rotation")]
        mirrored = [twin(truth, symmetry) for symmetry in _of_kind(found, "mirror")]
        return Likeness(concatenate(truth, *turned), concatenate(*mirrored) if mirrored else None)

    def errors_deg(self, poses: Poses) -> Array:
        """(N,) angles to the truth."""
        return _nearest_deg(poses, self.truths)

    def right_twin(self, found: Poses) -> bool | None:
        """Whether a pose is the truth and not a mirror twin; None: it is neither, or there is no mirror plane."""
        if self.twins is None:
            return None
        if float(self.errors_deg(found)[0]) <= NEAR_DEG:
            return True
        return False if float(_nearest_deg(found, self.twins)[0]) <= NEAR_DEG else None


def margin(truth: float, values: Array, errors_deg: Array) -> float | None:
    """Nats by which the truth beats every other basin; ``values`` (N,) are log posteriors of what a search met.

    ``truth`` is that of the truth itself after refinement: where the search found the truth's basin at a better
    place, that counts. None: no other basin was met.
    """
    others = errors_deg > NEAR_DEG
    if not others.any():
        return None
    return float(max([truth, *values[~others]]) - values[others].max())


def twin_margin(truth: float, values: Array, errors_deg: Array) -> float | None:
    """Nats by which the truth beats the best of its refined mirror twins. None: all of them ended at the truth."""
    others = errors_deg > NEAR_DEG
    return float(truth - values[others].max()) if others.any() else None


def squared_deviation(refined: Poses, covariance: Array, truth: Poses) -> float:
    """d' C^-1 d of the rotation that is missing, about body axes; of a batch of one."""
    missing = local(refined, truth)[0, :3]
    return float(missing @ np.linalg.solve(covariance[:3, :3], missing))


def _of_kind(symmetries: Sequence[Symmetry], kind: str) -> list[Symmetry]:
    return [symmetry for symmetry in symmetries if symmetry.kind == kind]


def _nearest_deg(poses: Poses, others: Poses) -> Array:
    gaps = angle_between(poses.quaternion[:, None], others.quaternion[None])
    return np.asarray(np.rad2deg(gaps.min(axis=1)))

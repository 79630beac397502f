"""Poses on their way through a search, best first (docs/model.md, section 4)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from service.inference.articulation import Articulation
from service.inference.estimate import short_way
from service.inference.model.drawing import Drawing, Images
from service.inference.model.stages import Stage
from service.inference.numerics.gauss_newton import ascend
from service.inference.numerics.hill import Hill, Looked, Refined, looked
from service.inference.numerics.priors import PosePrior
from service.inference.pose import concatenate
from service.inference.revolution import Axis, angle_apart, turned_within
from service.inference.state import Array, Poses

# numerical: nats behind the best from the sharp stage on: of 191 frames the truth was 55 behind there at the most
HOPELESS = 100.0
_LOOKED_THROUGH = 12  # numerical: candidates a basin that is kept
SHARED_DEG = 5.0  # numerical: poses nearer than this are one basin while it is coarse
SAME_DEG = 2.0  # numerical: after refinement
# numerical: of a joint's range, 22 degrees of a whole turn: as far apart, two poses turned alike are two basins
_JOINT_APART = 0.06
_TURNED_ALIKE = 4  # numerical: basins that differ in their joints alone: more would crowd out other rotations

_AT_ONCE_BYTES = 1 << 24  # numerical: of pictures that are drawn at once: of more the pages come anew each time


@dataclass(frozen=True)
class Candidates:
    """Poses on their way, each with its Sun."""

    poses: Poses
    suns: Array  # (N, 3)
    found: Array  # (N,) log posterior at the last stage; -inf: not looked at
    looked: Looked | None = None  # at that stage

    def __len__(self) -> int:
        return len(self.found)

    def __getitem__(self, index: NDArray[np.intp] | slice) -> Candidates:
        kept = None if self.looked is None else self.looked[index]
        return Candidates(self.poses[index], self.suns[index], self.found[index], kept)


def scored(hill: Hill, some: Candidates, near: Images | None = None) -> Candidates:
    """The same with their log posteriors on a hill, best first.

    ``near`` (U,): unknowns of the light of a pose near all of them, to begin with.
    """
    found, start, count = log_prior(some.poses, some.suns, hill.told), 0, max(_AT_ONCE_BYTES // hill.bytes_drawn, 1)
    while start < len(some):
        few = slice(start, start + count)
        planes = hill.drawing.cut(some.poses[few], some.suns[few], hill.view, hill.quality)
        terms = None if near is None else hill.terms.begun(np.tile(near, (len(planes), 1)))
        found[few] += hill.log_evidences(planes, terms)
        start, count = start + count, max(_AT_ONCE_BYTES * len(planes) // planes.nbytes, 1)
    return Candidates(some.poses, some.suns, found)[np.argsort(-found)]


def looked_at(hill: Hill, some: Candidates) -> tuple[Candidates, Looked]:
    """``scored``, the light of each at its best and kept: for a few, that climb on. And the best one's."""
    at = looked(hill, some.poses, some.suns)
    found = at.log_evidence + log_prior(some.poses, some.suns, hill.told)
    order = np.argsort(-found)
    return Candidates(some.poses, some.suns, found, at)[order], at[order[:1]]


def climbed(hill: Hill, some: Candidates, stage: Stage, hopeless: float = np.inf) -> Candidates:
    """The best basins after a few steps of Gauss-Newton, best first; none of none."""
    if not len(some):
        return some
    articulation = hill.drawing.articulation
    some = best_of(some, stage.kept, articulation)
    given = hill, some.poses, some.suns
    out = ascend(*given, steps=stage.steps, covariance="none", hopeless=hopeless, start=some.looked)
    moved = Candidates(
        concatenate(*[one.pose for one in out]),
        np.stack([one.sun for one in out]),
        np.array([one.log_posterior for one in out]),
    )
    return best_of(moved, len(out), articulation)


def joined(several: Sequence[Candidates]) -> Candidates:
    """All of them, in the order given."""
    return Candidates(
        concatenate(*[one.poses for one in several]),
        np.concatenate([one.suns for one in several]),
        np.concatenate([one.found for one in several]),
    )


def best_of(some: Candidates, kept: int, articulation: Articulation | None = None) -> Candidates:
    """The best of each basin, best first. ``articulation``: poses turned alike are told apart by their joints."""
    order = np.argsort(-some.found)
    order = order[distinct(some.poses[order[: _LOOKED_THROUGH * kept]], np.deg2rad(SHARED_DEG), articulation)][:kept]
    return some[order]


def distinct(
    poses: Poses, apart: float, articulation: Articulation | None = None, axes: Sequence[Axis] = ()
) -> NDArray[np.intp]:
    """Indices of those that are no nearer than ``apart`` (rad) to one before them, or have joints of their own.

    ``axes``: about which a turn changes nothing that can be seen; those of ``articulation``, where it is given.
    """
    axes = axes if articulation is None else articulation.round_axes
    alike = np.triu(turned_within(poses.quaternion, apart, axes), 1)
    some, others = np.divmod(np.flatnonzero(alike), max(len(poses), 1))
    share = np.full(len(some), _TURNED_ALIKE)  # of what drives one out: all, where the joints are alike too
    if articulation is not None and articulation.n_joints:
        off = np.abs(short_way(poses.joints[others] - poses.joints[some], articulation.wrapping))
        share[np.any(off >= _JOINT_APART * articulation.spans, axis=1)] = 1
    starts = np.searchsorted(some, np.arange(len(poses) + 1)).tolist()
    kept, met = [], np.zeros(len(poses), dtype=np.intp)
    for k, (start, end) in enumerate(pairwise(starts)):
        if met[k] < _TURNED_ALIKE:
            kept.append(k)
            if start < end:
                met[others[start:end]] += share[start:end]
    return np.array(kept, dtype=np.intp)


def best_of_each(some: Sequence[Refined], axes: Sequence[Axis]) -> list[Refined]:
    """The best of each basin, best first. ``axes``: of a body of revolution."""
    ordered = sorted(some, key=lambda one: -one.log_posterior)
    kept = distinct(concatenate(*[one.pose for one in ordered]), np.deg2rad(SAME_DEG), axes=axes)
    return [ordered[k] for k in kept]


def turned_alike(one: Poses, others: Poses, articulation: Articulation) -> NDArray[np.bool_]:
    """(N,) which of N poses are another look at a batch of one: where it points, and its joints."""
    near = angle_apart(one.quaternion, others.quaternion, articulation.round_axes) < np.deg2rad(SHARED_DEG)
    off = np.abs(short_way(others.joints - one.joints, articulation.wrapping))
    return np.asarray(near & np.all(off < _JOINT_APART * articulation.spans, axis=1))


def unlike(some: Candidates, others: Poses, articulation: Articulation) -> Candidates:
    """Those that are no other look at any of some poses."""
    alike = [turned_alike(some.poses[k : k + 1], others, articulation).any() for k in range(len(some))]
    return some[np.flatnonzero(~np.array(alike, dtype=bool))]


def log_prior(poses: Poses, suns: Array, told: PosePrior) -> Array:
    """(N,) of the scale, and of joints that turn towards the Sun."""
    out = np.zeros(len(poses))
    if told.log_scale is not None:
        out -= 0.5 * ((poses.log_scale - told.log_scale) / told.log_scale_sigma) ** 2
    return out if told.tracking is None else out + told.tracking.log_density(poses, suns)


def searched_joints(drawing: Drawing, told: PosePrior) -> list[int]:
    """Columns of joints of which nothing is known."""
    known = () if told.tracking is None else told.tracking.columns
    return [k for k in range(drawing.articulation.n_joints) if k not in known]

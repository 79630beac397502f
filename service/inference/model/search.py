"""A frame of which nothing is known: templates, coarse evidence, refinement, basins (docs/model.md, 4)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from service.inference.model import bank as banks
from service.inference.model.drawing import View
from service.inference.model.likelihood import terms_of
from service.inference.model.templates import Bank
from service.inference.numerics.gauss_newton import Hill, PosePrior, Refined, ascend
from service.inference.pose import angle_between, concatenate
from service.inference.state import Array, Poses

BANK_SIZE = 4500
_PER_KIND = 48  # templates of each kind that are looked at with the likelihood
_SHARED_DEG = 5.0  # poses nearer than this are one basin while it is coarse
_SAME_DEG = 2.0  # after refinement
"""Numerical: how much is searched. A search that stops early misses the truth, it does not change its weight."""


@dataclass(frozen=True)
class Basins:
    """What a search found, best first."""

    poses: Poses
    log_evidence: Array  # (B,)


@dataclass(frozen=True)
class Level:
    """One resolution of a search: how finely poses are drawn and smoothed, and how far they climb."""

    hill: Hill
    kept: int  # basins that climb
    steps: int  # of Gauss-Newton, each

    def score(self, poses: Poses, sun: Array) -> Array:
        """(N,) log posterior of poses, all under one Sun."""
        hill = self.hill
        planes = hill.drawing.planes(poses, sun, hill.view, hill.quality)
        terms = terms_of(hill.scene, hill.drawing.n_groups, planes.shape[1])
        answers = hill.drawing.light.evidence(planes, hill.drawing.n_groups, terms, hill.rounds)
        return np.asarray(answers.log_evidence + log_prior(poses, hill.told))


def propose(bank: Bank, image: NDArray[np.float32], sigma: float, told: PosePrior, view: View) -> Poses:
    """The templates most like the frame: the best of each kind. ``image``: the patch that ``view`` shows."""
    seen = banks.looks(image, sigma)
    log_scale = None if told.log_scale is None else told.log_scale - np.log(view.binning)
    scores, poses = banks.match(bank, seen, log_scale, told.log_scale_sigma)
    chosen = []
    for k, here in enumerate(poses):
        order = np.argsort(-scores[k])[: 3 * _PER_KIND]
        order = order[scores[k][order] > 0]
        chosen.append(here[order[distinct(here[order], np.deg2rad(6.0))][:_PER_KIND]])
    found = concatenate(*chosen)
    position = found.position * view.binning + np.asarray(view.origin)
    return Poses(found.quaternion, position, found.log_scale + np.log(view.binning), found.joints)


def distinct(poses: Poses, apart: float, joints: Array | None = None) -> NDArray[np.intp]:
    """Indices of those that are no nearer than ``apart`` (rad) to one before them."""
    kept: list[int] = []
    for k in range(len(poses)):
        if not kept or angle_between(poses.quaternion[kept], poses.quaternion[k]).min() > apart:
            kept.append(k)
    return np.array(kept, dtype=np.intp)


def climb(levels: Sequence[Level], poses: Poses, sun: Array) -> Basins:
    """From the coarsest level to the finest, in as many basins as are worth it."""
    found = np.empty(0)
    for level in levels:
        poses, found = best_of(poses, level.score(poses, sun), level.kept, _SHARED_DEG)
        climbed = ascend(level.hill, poses, np.tile(sun, (len(poses), 1)), steps=level.steps, covariance=False)
        poses = concatenate(*[one.pose for one in climbed])
        found = np.array([one.log_posterior for one in climbed])
    return Basins(*best_of(poses, found, len(found), _SHARED_DEG))


def best_of(poses: Poses, found: Array, kept: int, degrees: float) -> tuple[Poses, Array]:
    """The best of each basin, best first."""
    order = np.argsort(-found)
    order = order[distinct(poses[order[: 12 * kept]], np.deg2rad(degrees))][:kept]
    return poses[order], found[order]


def log_prior(poses: Poses, told: PosePrior) -> Array:
    """(N,) of the scale."""
    if told.log_scale is None:
        return np.zeros(len(poses))
    return np.asarray(-0.5 * ((poses.log_scale - told.log_scale) / told.log_scale_sigma) ** 2)


def refined(hill: Hill, basins: Basins, sun: Array, count: int, steps: int) -> list[Refined]:
    """The best basins after Gauss-Newton at the finest level, best first; basins that met are one."""
    poses = basins.poses[:count]
    out = ascend(hill, poses, np.tile(sun, (len(poses), 1)), steps=steps)
    out.sort(key=lambda found: -found.log_posterior)
    kept = distinct(concatenate(*[found.pose for found in out]), np.deg2rad(_SAME_DEG))
    return [out[k] for k in kept]

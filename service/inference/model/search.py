"""A frame of which nothing is known: templates, then poses that climb from coarse to fine (docs/model.md, 4)."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from service.inference.model import bank as banks
from service.inference.model.drawing import FINE, Drawing, Quality, View
from service.inference.model.likelihood import Scene, terms_of
from service.inference.model.nuisance import Nuisance, best_discrepancy, best_spread
from service.inference.model.templates import Bank, directions
from service.inference.numerics.gauss_newton import Hill, PosePrior, Refined, Trust, ascend, within
from service.inference.pose import angle_between, concatenate, retract
from service.inference.state import Array, Poses


class PatchLike(Protocol):
    """``service.imaging.patch.Patch``."""

    @property
    def image(self) -> NDArray[np.float32]:
        """(S, S) light above the sky, counts."""
        ...

    @property
    def sigma(self) -> float:
        """Noise of one pixel of empty sky, counts."""
        ...

    @property
    def photon(self) -> float:
        """Variance per count."""
        ...

    @property
    def hidden(self) -> float:
        """Light of the sky that a body can hide at the most, counts."""
        ...

    @property
    def censored(self) -> NDArray[np.bool_]:
        """(S, S) pixels of which only a least value is known."""
        ...

    @property
    def origin(self) -> tuple[float, float]:
        """First corner, frame px."""
        ...

    @property
    def binning(self) -> int:
        """Frame px a side of a patch pixel."""
        ...


@dataclass(frozen=True)
class Sight:
    """A frame as a search sees it."""

    cut: Callable[[float, float], PatchLike]  # span (px) that the light fills, patch px that it should fill -> patch
    span: float  # of the light, px
    psf: float  # first guess of the point spread's width, px


@dataclass(frozen=True)
class Body:
    """One body, drawn from roughly to finely."""

    rough: Drawing
    middle: Drawing
    fine: Drawing


@dataclass(frozen=True)
class Stage:
    """One resolution of a search. All numbers are numerical: a search that stops early misses the truth, no more."""

    wanted: float  # patch px that the light spans
    low_pass: float  # patch px, at the least
    kept: int  # basins that climb
    steps: int  # of Gauss-Newton
    difference: float  # patch px
    quality: Quality
    trust: Trust


FIRST = Stage(18, 1.5, 150, 1, 1.0, Quality(2, 96, ()), Trust(0.2, 0.15, 0.15, 0.4))
ROUGH = Stage(18, 1.5, 56, 2, 1.0, Quality(2, 96, ()), Trust(0.2, 0.15, 0.15, 0.4))
MIDDLE = Stage(28, 1.0, 24, 2, 0.7, Quality(2, 128), Trust())
SHARP = Stage(44, 0.8, 10, 2, 0.6, Quality(3, 192), Trust())
FINEST = Stage(96, 0.7, 5, 6, 0.5, FINE, Trust())
BANK_SIZE = 4500  # rotations 12 degrees apart; as many again for each joint, three times at the most
_PER_KIND = 80  # templates of each kind that are looked at with the likelihood
_COARSE_ROUNDS = 4
_SHARED_DEG = 5.0  # poses nearer than this are one basin while it is coarse
_SAME_DEG = 2.0  # after refinement
_SHAKEN, _SHAKEN_KEPT, _SHAKEN_RAD = 24, 2, 0.12  # poses around the best, how many climb, how far about they lie
_LIT_SHARE = 0.65  # of a body's diameter that shows light, as a rule
_TRIED = 60  # basins whose joints and Suns are tried anew
_TOGETHER = 2  # joints that are tried in all combinations; more of them one after the other
_VALUES = (8, 6)  # of each joint, alone or of two together
_SUNS = 14


@dataclass(frozen=True)
class Found:
    """What a search ends with: basins, best first, on one patch under one point spread and discrepancy."""

    basins: list[Refined]
    hill: Hill
    nuisance: Nuisance  # frame px


@dataclass(frozen=True)
class Candidates:
    """Poses on their way, each with its Sun."""

    poses: Poses
    suns: Array  # (N, 3)
    found: Array  # (N,) log posterior at the last stage; -inf: not looked at

    def __getitem__(self, index: NDArray[np.intp]) -> Candidates:
        return Candidates(self.poses[index], self.suns[index], self.found[index])


def search(body: Body, sight: Sight, bank: Bank, told: PosePrior) -> Found:
    """All that a frame alone says of a pose."""
    nuisance = Nuisance(sight.psf)
    if told.log_scale is not None:  # a body that is known to be large may show little of its light at a place
        across = _LIT_SHARE * 2 * body.fine.radius * float(np.exp(told.log_scale))
        sight = replace(sight, span=max(sight.span, across))
    first = sight.cut(sight.span, MIDDLE.wanted)
    some = propose(bank, first, told)
    if not len(some.found):
        return Found([], stage_hill(body.fine, sight, FINEST, nuisance, told, speckle=True), nuisance)
    hill = stage_hill(body.rough, sight, ROUGH, nuisance, told, speckle=False)
    some = best_of(scored(hill, some), len(some.found), _SHARED_DEG)
    some = climbed(hill, varied(hill, some), FIRST)
    some = climbed(hill, varied(hill, some), ROUGH)
    hill = stage_hill(body.middle, sight, MIDDLE, nuisance, told, speckle=False)
    some = climbed(hill, scored(hill, some), MIDDLE)
    nuisance = best_spread(hill, some.poses[:3], some.suns[:3], nuisance)
    hill = stage_hill(body.middle, sight, SHARP, nuisance, told, speckle=False)
    some = climbed(hill, scored(hill, some), SHARP)
    return finished(body, sight, some, nuisance, told)


def finished(body: Body, sight: Sight, some: Candidates, nuisance: Nuisance, told: PosePrior) -> Found:
    """The best basins at the finest stage: point spread and discrepancy found at the best of them, then held."""
    hill = stage_hill(body.fine, sight, FINEST, nuisance, told, speckle=True)
    some = scored(hill, some)
    nuisance = best_spread(hill, some.poses[:1], some.suns[:1], nuisance)
    hill = stage_hill(body.fine, sight, FINEST, nuisance, told, speckle=True)
    some = some[np.arange(min(FINEST.kept, len(some.found)))]
    nuisance = best_discrepancy(hill, some.poses[:1], some.suns[:1], nuisance)
    hill = stage_hill(body.fine, sight, FINEST, nuisance, told, speckle=True)
    out = ascend(hill, some.poses, some.suns, steps=FINEST.steps)
    out.sort(key=lambda one: -one.log_posterior)
    near = shaken(hill, out[0])
    out += ascend(hill, near.poses, near.suns, steps=FINEST.steps)
    out.sort(key=lambda one: -one.log_posterior)
    kept = distinct(concatenate(*[one.pose for one in out]), np.deg2rad(_SAME_DEG))
    return Found([out[k] for k in kept], hill, nuisance)


def shaken(hill: Hill, one: Refined) -> Candidates:
    """The best of what lies some degrees around a pose: what was flat while it was coarse is rough when it is fine."""
    d = 6 + one.pose.joints.shape[1]
    steps = np.random.default_rng(_SHAKEN).standard_normal((_SHAKEN, d))
    steps[:, :3] *= _SHAKEN_RAD
    steps[:, 3:5] *= 0.1 * _SHAKEN_RAD * hill.drawing.radius * np.exp(one.pose.log_scale)
    steps[:, 5] *= 0.2 * _SHAKEN_RAD
    steps[:, 6:] *= np.rad2deg(_SHAKEN_RAD)
    start = one.pose[np.zeros(_SHAKEN, dtype=np.intp)]
    moved = retract(start, steps)
    moved = replace(moved, joints=within(hill.drawing, moved.joints))
    around = scored(hill, Candidates(moved, np.tile(one.sun, (_SHAKEN, 1)), np.zeros(_SHAKEN)))
    return around[np.arange(_SHAKEN_KEPT)]


def stage_hill(
    drawing: Drawing, sight: Sight, stage: Stage, nuisance: Nuisance, told: PosePrior, *, speckle: bool
) -> Hill:
    """What poses climb on at a stage."""
    patch = sight.cut(sight.span, stage.wanted)
    spread = nuisance.point_spread(patch.binning)
    scene = Scene(
        patch.image,
        patch.sigma,
        patch.photon,
        patch.hidden,
        patch.censored,
        spread,
        nuisance.discrepancy,
        speckle,
        max(stage.low_pass, 0.7 * spread.width),
    )
    view = View(patch.origin, patch.binning, len(patch.image))
    free = speckle or told.towards_sun is None
    rounds = 6 if speckle else _COARSE_ROUNDS
    return Hill(scene, drawing, view, told, stage.quality, stage.difference, free, rounds, stage.trust)


def bank_size(n_joints: int) -> int:
    """Templates that a body of so many joints asks for."""
    return BANK_SIZE * (1 + min(2, n_joints))


def make_bank(body: Body, told: PosePrior) -> Bank:
    """Templates under the Sun that is told, or each under one of many."""
    count = bank_size(body.rough.articulation.n_joints)
    sun = told.towards_sun
    suns = directions(count) if sun is None else np.tile(sun, (count, 1))
    return banks.build(body.rough, suns)


def propose(bank: Bank, patch: PatchLike, told: PosePrior) -> Candidates:
    """The templates most like the frame: the best of each kind."""
    seen = banks.looks(patch.image, patch.sigma)
    log_scale = None if told.log_scale is None else told.log_scale - np.log(patch.binning)
    scores, poses = banks.match(bank, seen, log_scale, told.log_scale_sigma)
    chosen, suns = [], []
    for k, here in enumerate(poses):
        order = np.argsort(-scores[k])[: 3 * _PER_KIND]
        order = order[scores[k][order] > 0]
        order = order[distinct(here[order], np.deg2rad(_SHARED_DEG))][:_PER_KIND]
        chosen.append(here[order])
        suns.append(bank.suns[order])
    found = concatenate(*chosen)
    position = found.position * patch.binning + np.asarray(patch.origin)
    placed = Poses(found.quaternion, position, found.log_scale + np.log(patch.binning), found.joints)
    return Candidates(placed, np.concatenate(suns), np.full(len(placed), -np.inf))


def scored(hill: Hill, some: Candidates) -> Candidates:
    """The same with their log posteriors on a hill, best first."""
    planes = hill.drawing.planes(some.poses, some.suns, hill.view, hill.quality)
    terms = terms_of(hill.scene, hill.drawing.n_groups, planes.shape[1])
    answers = hill.drawing.light.evidence(planes, hill.drawing.n_groups, terms, hill.rounds)
    found = np.asarray(answers.log_evidence + log_prior(some.poses, hill.told))
    return Candidates(some.poses, some.suns, found)[np.argsort(-found)]


def climbed(hill: Hill, some: Candidates, stage: Stage) -> Candidates:
    """The best basins after a few steps of Gauss-Newton, best first."""
    some = best_of(some, stage.kept, _SHARED_DEG)
    out = ascend(hill, some.poses, some.suns, steps=stage.steps, covariance=False)
    moved = Candidates(
        concatenate(*[one.pose for one in out]),
        np.stack([one.sun for one in out]),
        np.array([one.log_posterior for one in out]),
    )
    return best_of(moved, len(out), _SHARED_DEG)


def varied(hill: Hill, some: Candidates) -> Candidates:
    """What does not move is found first: with other joint values, and other Suns where none is told, it may fit."""
    some = best_of(some, len(some.found), _SHARED_DEG)
    tried, joints = [some], hill.drawing.articulation.joints
    together = [range(len(joints))] if len(joints) <= _TOGETHER else [[k] for k in range(len(joints))]
    for chosen in together if joints else ():
        few = best_of(_joined(tried), _TRIED // len(chosen), _SHARED_DEG)
        count = _VALUES[min(len(chosen), len(_VALUES)) - 1]
        for at in np.ndindex(*[count] * len(chosen)):
            values = few.poses.joints.copy()
            for k, place in zip(chosen, at, strict=True):
                values[:, k] = joints[k].minimum + (place + 0.5) / count * (joints[k].maximum - joints[k].minimum)
            tried.append(scored(hill, replace(few, poses=replace(few.poses, joints=values))))
    if hill.told.towards_sun is None:
        few = best_of(_joined(tried), _TRIED, _SHARED_DEG)
        suns = (np.tile(sun, (len(few.found), 1)) for sun in directions(_SUNS))
        tried += [scored(hill, replace(few, suns=sun)) for sun in suns]
    return _joined(tried)


def _joined(several: Sequence[Candidates]) -> Candidates:
    return Candidates(
        concatenate(*[one.poses for one in several]),
        np.concatenate([one.suns for one in several]),
        np.concatenate([one.found for one in several]),
    )


def best_of(some: Candidates, kept: int, degrees: float) -> Candidates:
    """The best of each basin, best first."""
    order = np.argsort(-some.found)
    order = order[distinct(some.poses[order[: 12 * kept]], np.deg2rad(degrees))][:kept]
    return some[order]


def distinct(poses: Poses, apart: float) -> NDArray[np.intp]:
    """Indices of those that are no nearer than ``apart`` (rad) to one before them."""
    kept: list[int] = []
    for k in range(len(poses)):
        if not kept or angle_between(poses.quaternion[kept], poses.quaternion[k]).min() > apart:
            kept.append(k)
    return np.array(kept, dtype=np.intp)


def log_prior(poses: Poses, told: PosePrior) -> Array:
    """(N,) of the scale."""
    if told.log_scale is None:
        return np.zeros(len(poses))
    return np.asarray(-0.5 * ((poses.log_scale - told.log_scale) / told.log_scale_sigma) ** 2)

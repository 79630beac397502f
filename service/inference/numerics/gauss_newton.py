"""Poses at their best: Gauss-Newton on pose, joints and the Sun, with the linear unknowns of the light eliminated.

Many poses climb at once: each round draws all that their derivatives need in one launch.
"""

from __future__ import annotations

from typing import Literal

import numpy as np
from numpy.typing import NDArray

from service.inference.model.derivatives import across
from service.inference.model.drawing import EVEN_PLANES, Drawing
from service.inference.model.likelihood import Fit
from service.inference.model.paint import painted
from service.inference.model.scene import Images
from service.inference.numerics.curvature import paint_variance, slopes_of, systems_of
from service.inference.numerics.hill import AFRESH, Hill, Looked, Refined
from service.inference.numerics.priors import Believed, PosePrior
from service.inference.pose import retract
from service.inference.state import Array, Poses

ENOUGH = 0.1  # numerical: nats: a step that gains less is the last
_ROUNDING = 1e-6  # numerical: of a curvature in units of its diagonal: float32's
# numerical: nats: a step that promises less is taken without a look, whose own rounding is as much
_UNSEEN = 1.0
_TRIAL_STEPS = 2  # numerical: that any pose may take
_SHORTER = 0.3  # numerical: of a step that did not climb


def ascend(
    hill: Hill,
    poses: Poses,
    suns: Array,
    *,
    steps: int,
    covariance: Literal["exact", "last", "none"] = "exact",
    believed: Believed | None = None,
    enough: float | Array = ENOUGH,
    hopeless: float = np.inf,
    start: Looked | None = None,
    near: Images | None = None,
) -> list[Refined]:
    """Climb from N poses, each with its Sun (N, 3), ``steps`` at the most. In the order given.

    ``enough``: nats, (N,) if each its own: the last step is the one that gains less, or to so much what the slopes at
    its start promise of the top.
    ``hopeless``: nats; after two steps those go no further that are so much behind the best.
    ``start``: the same poses on a hill that may differ in its scene. ``near`` (N, U): unknowns of the light of poses
    near them, to begin with.
    ``covariance``: at the end, at the last place whose slopes are known (which is cheaper), or none.
    """
    climb = _Climb(hill, poses, suns, believed, np.broadcast_to(enough, len(poses)), start, near)
    for k in range(steps):
        climb.step()
        if k + 1 >= _TRIAL_STEPS:
            climb.leave(hopeless)
    return climb.refined(covariance)


class _Climb:
    """N poses on their way up one hill."""

    def __init__(
        self,
        hill: Hill,
        poses: Poses,
        suns: Array,
        believed: Believed | None,
        enough: Array,
        start: Looked | None = None,
        near: Images | None = None,
    ) -> None:
        n, d = len(poses), 6 + poses.joints.shape[1]
        self._hill, self._believed, self._enough = hill, believed, enough
        self._poses, self._suns = poses, suns.copy()
        self._fits, self._scores = _look(hill, poses, self._suns, believed, np.arange(n), near, start)
        self._curvatures: list[Array] = [np.full((d, d), np.nan)] * n  # stated
        self._believed_curvatures = self._curvatures.copy()
        self._going = np.ones(n, dtype=bool)
        self._slopes: dict[np.intp, Images] = {}
        self._shifted = np.zeros(n)  # patch px by which a rim moved since its slopes were drawn

    def step(self) -> None:
        """One step of all that are still on their way."""
        at = np.flatnonzero(self._going)
        if not len(at):
            return
        curvature, pull = self._systems(at)
        promised = 0.5 * np.sum(pull * _solved(curvature, pull), axis=1)
        moves = self._moves(curvature, pull, at)
        sure = promised <= np.maximum(self._enough[at], _UNSEEN)
        if sure.any():
            self._go(at[sure], *_moved(self._poses[at[sure]], self._suns[at[sure]], moves[sure], self._hill))
            self._scores[at[sure]] += promised[sure]
            self._going[at[sure]] = False
            at, moves, promised = at[~sure], moves[~sure], promised[~sure]
        if not len(at):
            return
        before = self._scores[at].copy()
        self._try(at, moves)
        short = (self._scores[at] <= before) & (promised > self._enough[at])
        if short.any():
            self._try(at[short], _SHORTER * moves[short])
        gained = self._scores[at] - before
        self._going[at] = np.minimum(gained, np.abs(promised - gained)) > self._enough[at]

    def _moves(self, curvature: Array, pull: Array, at: NDArray[np.intp]) -> Array:
        """(N, D) steps, held within ``trust``."""
        damping = _damping(self._hill, self._poses[at])
        return _solved(curvature + damping[:, None] * np.eye(damping.shape[1]), pull)

    def leave(self, behind: float) -> None:
        """Those that are so many nats behind the best."""
        self._going &= self._scores > self._scores.max() - behind

    def refined(self, covariance: Literal["exact", "last", "none"]) -> list[Refined]:
        """Where all of them are."""
        hill, d, everybody = self._hill, 6 + self._poses.joints.shape[1], np.arange(len(self._poses))
        if covariance == "exact":
            self._shifted[:] = np.inf
            self._systems(everybody)
        whole = [c if covariance == "none" else _inverse(c) for c in self._curvatures]
        sun_sigmas = [_sun_sigma(hill, spread, d) for spread in whole]
        paint = [self._paint_variance(k, covariance != "none") for k in everybody]
        found = zip(self._suns, sun_sigmas, self._fits, self._scores, whole, paint, strict=True)
        return [
            Refined(self._poses[k : k + 1], sun, sun_sigma, fit, float(score), spread[:d, :d], unsure)
            for k, (sun, sun_sigma, fit, score, spread, unsure) in enumerate(found)
        ]

    def _paint_variance(self, k: np.intp, wanted: bool) -> Array:
        fit = self._fits[k]
        if not wanted or k not in self._slopes:
            return np.full(len(fit.coefficients) - EVEN_PLANES, np.inf)
        return paint_variance(fit, self._slopes[k], _inverse(self._believed_curvatures[k]))

    def _try(self, at: NDArray[np.intp], moves: Array) -> None:
        """Go where it is higher."""
        poses, suns = _moved(self._poses[at], self._suns[at], moves, self._hill)
        ended = np.stack([self._fits[k].values for k in at])
        fits, scores = _look(self._hill, poses, suns, self._believed, at, ended)
        better = np.flatnonzero(scores > self._scores[at])
        there = at[better]
        self._shifted[there] += _rim_shift(self._hill, poses[better], moves[better])
        self._go(there, poses[better], suns[better])
        self._scores[there] = scores[better]
        for k, new in zip(there, better, strict=True):
            self._fits[k] = fits[new]

    def _go(self, there: NDArray[np.intp], poses: Poses, suns: Array) -> None:
        self._poses, self._suns[there] = _replaced(self._poses, there, poses), suns

    def _systems(self, at: NDArray[np.intp]) -> tuple[Array, Array]:
        """Curvatures and slopes; their pictures drawn anew where the rim moved further than the differences reach."""
        old = at[[k not in self._slopes or self._shifted[k] > self._hill.difference for k in at]]
        drawn = None
        if len(old):
            fits = [self._fits[k] for k in old]
            drawn = slopes_of(self._hill, self._poses[old], self._suns[old], fits)
            self._slopes.update(zip(old, drawn, strict=True))
            self._shifted[old] = 0.0
        fits = [self._fits[k] for k in at]
        slopes = drawn if drawn is not None and len(old) == len(at) else np.stack([self._slopes[k] for k in at])
        systems = systems_of(self._hill, self._poses[at], self._suns[at], fits, slopes, self._believed, at)
        for k, curvature, stated in zip(at, systems[0], systems[2], strict=True):
            self._curvatures[k], self._believed_curvatures[k] = stated, curvature
        return systems[0], systems[1]


def _solved(curvature: Array, pull: Array) -> Array:
    """(N, D) solutions of N systems."""
    return np.asarray(np.linalg.solve(curvature, pull[..., None])[..., 0], dtype=np.float64)


def _rim_shift(hill: Hill, poses: Poses, moves: Array) -> Array:
    """(N,) patch px by which such moves (N, D) shift the rim at the most."""
    rim = hill.drawing.radius * np.exp(poses.log_scale) / hill.view.binning
    turned = [np.linalg.norm(moves[:, :3], axis=1), np.abs(moves[:, 5])]
    for k, joint in enumerate(hill.drawing.articulation.joints, 6):
        one = np.deg2rad(1.0) if joint.kind == "revolute" else 1 / hill.drawing.radius
        turned.append(one * np.abs(moves[:, k]))
    return np.asarray(rim * np.sum(turned, axis=0) + np.linalg.norm(moves[:, 3:5], axis=1) / hill.view.binning)


def _sun_sigma(hill: Hill, spread: Array, d: int) -> float:
    """Rad, each axis: of a pose's whole covariance; what was told where the Sun does not move."""
    if not hill.sun_free or len(spread) == d:
        return hill.told.sun_sigma
    return float(np.sqrt(0.5 * np.trace(spread[d:, d:])))


def _inverse(curvature: Array) -> Array:
    """Covariance of a curvature whose least directions may be lost in the pictures' rounding."""
    if not np.isfinite(curvature).all():
        return np.full_like(curvature, np.nan)
    size = np.sqrt(np.maximum(np.diag(curvature), 1e-30))
    values, vectors = np.linalg.eigh(0.5 * (curvature + curvature.T) / np.outer(size, size))
    return np.asarray((vectors / np.maximum(values, _ROUNDING)) @ vectors.T / np.outer(size, size))


def _look(
    hill: Hill,
    poses: Poses,
    suns: Array,
    believed: Believed | None = None,
    at: NDArray[np.intp] | None = None,
    ended: Images | None = None,
    start: Looked | None = None,
) -> tuple[list[Fit], Array]:
    """The light of each pose, and its log posterior; ``at``: their numbers among what is believed.

    ``ended``: unknowns of the light of poses near by, to begin with. ``start``: the same poses, looked at before.
    """
    if start is not None and start.is_drawn_on(hill):
        planes, which, ended = start.planes, start.which, start.values
    else:
        planes, which = hill.drawing.cut(poses, suns, hill.view, hill.quality), np.arange(len(poses))
    terms = hill.terms
    if believed is not None and at is not None:
        terms = painted(terms, believed.paint[at])
    if ended is not None:
        terms = terms.begun(ended)
    rounds = hill.rounds if ended is not None else AFRESH * hill.rounds
    found, details = hill.drawing.light.details(planes, hill.drawing.n_groups, terms, rounds, [*which])
    fits = [
        Fit(planes[k : k + 1], float(e), float(x), c, v, **vars(more))
        for k, e, x, c, v, more in zip(
            which, found.log_evidence, found.chi2, found.coefficients, found.values, details, strict=True
        )
    ]
    before = np.zeros(len(poses))
    if believed is not None and at is not None:
        before += believed.log_density(poses, at)
        if hill.told.towards_sun is None:
            before += believed.log_density_of_sun(suns, at)
    return fits, np.asarray(found.log_evidence + _log_prior(hill.told, poses, suns) + before)


def _log_prior(told: PosePrior, poses: Poses, suns: Array) -> Array:
    out = np.zeros(len(poses))
    if told.log_scale is not None:
        out -= 0.5 * ((poses.log_scale - told.log_scale) / told.log_scale_sigma) ** 2
    if told.towards_sun is not None:
        out -= 0.5 * (np.linalg.norm(suns - told.towards_sun, axis=1) / told.sun_sigma) ** 2
    if told.tracking is not None:
        out += told.tracking.log_density(poses, suns)
    return out


def _damping(hill: Hill, poses: Poses) -> Array:
    """(N, D) precisions that hold a step within ``trust``."""
    trust, joints = hill.trust, hill.drawing.articulation.joints
    rim = hill.drawing.radius * np.exp(poses.log_scale)
    reach = [np.rad2deg(trust.joint) if j.kind == "revolute" else trust.joint * (j.maximum - j.minimum) for j in joints]
    sun = [1.0] * 2 if hill.sun_free else []
    wide = np.array([trust.turn] * 3 + [1.0, 1.0, trust.log_scale, *reach, *sun])
    widths = np.repeat(wide[None], len(poses), axis=0)
    widths[:, 3:5] = (trust.place * rim)[:, None]
    return np.asarray(widths**-2)


def _moved(poses: Poses, suns: Array, moves: Array, hill: Hill) -> tuple[Poses, Array]:
    """Poses and Suns after their steps, joints kept in range."""
    d = 6 + poses.joints.shape[1]
    moved = stepped(hill.drawing, poses, moves[:, :d])
    if not hill.sun_free:
        return moved, suns.copy()
    turned = np.stack([sun + move[d:] @ across(sun) for sun, move in zip(suns, moves, strict=True)])
    return moved, turned / np.linalg.norm(turned, axis=1, keepdims=True)


def stepped(drawing: Drawing, poses: Poses, steps: Array) -> Poses:
    """Poses moved by steps (N, 6 + J) of their tangent space, joints brought back into their range."""
    moved = retract(poses, steps)
    return Poses(moved.quaternion, moved.position, moved.log_scale, within(drawing, moved.joints))


def within(drawing: Drawing, joints: Array) -> Array:
    """(N, J) values brought back into their range: those that turn all the way wrap, others stop."""
    values, wrapping = joints.copy(), drawing.articulation.wrapping
    for k, joint in enumerate(drawing.articulation.joints):
        if wrapping[k]:
            values[:, k] = (values[:, k] - joint.minimum) % 360.0 + joint.minimum
        else:
            values[:, k] = np.clip(values[:, k], joint.minimum, joint.maximum)
    return values


def _replaced(poses: Poses, at: NDArray[np.intp], by: Poses) -> Poses:
    parts = [part.copy() for part in (poses.quaternion, poses.position, poses.log_scale, poses.joints)]
    for part, new in zip(parts, (by.quaternion, by.position, by.log_scale, by.joints), strict=True):
        part[at] = new
    return Poses(*parts)

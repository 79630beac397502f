"""Poses at their best: Gauss-Newton on pose, joints and the Sun, with the linear unknowns of the light eliminated.

Many poses climb at once: each round draws all that their derivatives need in one launch.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from service.inference.model.derivatives import across, derivatives
from service.inference.model.drawing import Drawing
from service.inference.model.likelihood import Fit, Images, terms_of
from service.inference.model.paint import painted
from service.inference.model.prior import CHI2_DEGREES_OF_FREEDOM, POSE_DEGREES_OF_FREEDOM
from service.inference.numerics.hill import Hill, Refined
from service.inference.numerics.priors import Believed, PosePrior
from service.inference.pose import retract
from service.inference.state import Array, Poses

ENOUGH = 0.1  # nats: a step that gains less is the last
_ROUNDING = 1e-6  # of a curvature in units of its diagonal: float32's
_SHORTER = 0.3  # of a step that did not climb
_DETAILS = ("residual", "weight", "model", "light", "columns", "precision", "deviation", "normal", "pull", "lit")


def ascend(
    hill: Hill,
    poses: Poses,
    suns: Array,
    *,
    steps: int,
    covariance: Literal["exact", "last", "none"] = "exact",
    believed: Believed | None = None,
    enough: float | Array = ENOUGH,
) -> list[Refined]:
    """Climb from N poses, each with its Sun (N, 3), ``steps`` at the most. In the order given.

    ``enough``: nats, (N,) if each its own: the last step is the one that gains less, or to so much what the slopes at
    its start promise of the top.
    ``covariance``: at the end, at the place of the last step's start (which is cheaper), or none.
    """
    suns, d = suns.copy(), 6 + poses.joints.shape[1]
    fits, scores = _look(hill, poses, suns, believed, np.arange(len(poses)))
    curvatures: list[Array] = [np.full((d, d), np.nan)] * len(poses)
    going = np.ones(len(poses), dtype=bool)
    least = np.broadcast_to(enough, len(poses))
    slopes: dict[np.intp, Images] = {}
    shifted = np.zeros(len(poses))  # patch px by which a rim moved since its slopes were drawn
    for _ in range(steps):
        at = np.flatnonzero(going)
        if not len(at):
            break
        _renew(slopes, shifted, hill, at, poses, suns, fits)
        systems = _systems(hill, poses[at], suns[at], [fits[k] for k in at], [slopes[k] for k in at], believed, at)
        for k, (_, _, curvature) in zip(at, systems, strict=True):
            curvatures[k] = curvature
        damping = _damping(hill, poses[at])
        moves = np.array([np.linalg.solve(c + np.diag(d), p) for (c, p, _), d in zip(systems, damping, strict=True)])
        before = scores[at].copy()
        for share in (1.0, _SHORTER):
            left = at[scores[at] <= before] if share < 1 else at
            if not len(left):
                break
            chosen = np.searchsorted(at, left)
            trial, trial_suns = _moved(poses[left], suns[left], share * moves[chosen], hill)
            trial_fits, trial_scores = _look(hill, trial, trial_suns, believed, left)
            better = np.flatnonzero(trial_scores > scores[left])
            poses = _replaced(poses, left[better], trial[better])
            suns[left[better]] = trial_suns[better]
            scores[left[better]] = trial_scores[better]
            shifted[left[better]] += _rim_shift(hill, poses[left[better]], share * moves[chosen[better]])
            for k in better:
                fits[left[k]] = trial_fits[k]
        gained = scores[at] - before
        promised = np.array([0.5 * p @ np.linalg.solve(c, p) for c, p, _ in systems])
        going[at] = np.minimum(gained, np.abs(promised - gained)) > least[at]
    if covariance == "exact":
        last = list(_slopes(hill, poses, suns, fits))
        curvatures = [c for _, _, c in _systems(hill, poses, suns, fits, last, believed, np.arange(len(poses)))]
    whole = [c if covariance == "none" else _inverse(c) for c in curvatures]
    sun_sigmas = [_sun_sigma(hill, spread, d) for spread in whole]
    return [
        Refined(poses[k : k + 1], suns[k], sun_sigmas[k], fits[k], float(scores[k]), whole[k][:d, :d])
        for k in range(len(poses))
    ]


def _renew(
    slopes: dict[np.intp, Images],
    shifted: Array,
    hill: Hill,
    at: NDArray[np.intp],
    poses: Poses,
    suns: Array,
    fits: list[Fit],
) -> None:
    """Slopes of those that moved further since theirs were drawn than the differences that they are made of."""
    old = at[[k not in slopes or shifted[k] > hill.difference for k in at]]
    if len(old):
        slopes.update(zip(old, _slopes(hill, poses[old], suns[old], [fits[k] for k in old]), strict=True))
        shifted[old] = 0.0


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
    hill: Hill, poses: Poses, suns: Array, believed: Believed | None = None, at: NDArray[np.intp] | None = None
) -> tuple[list[Fit], Array]:
    """The light of each pose, and its log posterior; ``at``: their numbers among what is believed."""
    planes = hill.drawing.planes(poses, suns, hill.view, hill.quality)
    terms = terms_of(hill.scene, hill.drawing.n_groups, planes.shape[1])
    if believed is not None and at is not None:
        terms = painted(terms, believed.paint[at])
    found, details = hill.drawing.light.details(planes, hill.drawing.n_groups, terms, hill.rounds)
    fits = [
        Fit(float(e), float(x), c, *(getattr(more, name) for name in _DETAILS))
        for e, x, c, more in zip(found.log_evidence, found.chi2, found.coefficients, details, strict=True)
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
    return out


def _systems(
    hill: Hill,
    poses: Poses,
    suns: Array,
    fits: list[Fit],
    slopes: Sequence[Images],
    believed: Believed | None = None,
    at: NDArray[np.intp] | None = None,
) -> list[tuple[Array, Array, Array]]:
    """Curvature (D, D) and slope (D,) of each log posterior, the linear unknowns eliminated; and the curvature of which
    a spread is stated: with the discrepancy's scale as it is seen, and as if the paint were unknown, since it was
    learnt from poses that erred as this one does.

    D: rotation (rad), place (frame px), log scale, joints, and the Sun (rad, two axes across it) where it is free.
    """
    known = None if believed is None or at is None else believed.paint[at, 1]
    found = [
        _system(hill, poses[k : k + 1], suns[k], fits[k], slopes[k], None if known is None else known[k])
        for k in range(len(poses))
    ]
    if believed is not None and at is not None:
        towards, d = -believed.away(poses, at), believed.precision.shape[1]
        for (normal, pull, stated), precision, away in zip(found, believed.precision[at], towards, strict=True):
            normal[:d, :d] += precision
            stated[:d, :d] += precision
            pull[:d] += precision @ away
        if hill.sun_free and hill.told.towards_sun is None:
            d = 6 + poses.joints.shape[1]
            for k, (normal, pull, stated) in zip(at, found, strict=True):
                sure, sun = believed.sun_precision[k], suns[np.searchsorted(at, k)]
                normal[range(d, d + 2), range(d, d + 2)] += sure
                stated[range(d, d + 2), range(d, d + 2)] += sure
                pull[d : d + 2] += sure * (across(sun) @ (believed.suns[k] - sun))
    return found


def _system(
    hill: Hill, pose: Poses, sun: Array, fit: Fit, slopes: NDArray[np.float32], known: Array | None
) -> tuple[Array, Array, Array]:
    flat = slopes.reshape(len(slopes), -1)
    weighted = flat * fit.weight.ravel()
    normal = (weighted @ flat.T).astype(np.float64)
    pull = (weighted @ fit.residual.ravel()).astype(np.float64)
    cross = (fit.columns.reshape(len(fit.columns), -1) @ weighted.T).astype(np.float64)
    prior = np.zeros_like(normal)
    _add_prior(hill, prior, pull, pose, sun)
    inner = np.linalg.solve(fit.normal, np.column_stack([cross, fit.pull]))
    d = len(slopes)
    slope = pull - cross.T @ inner[:, d]
    free = fit.normal.copy()
    if known is not None:
        free[range(len(fit.lit)), range(len(fit.lit))] -= known[fit.lit]
    doubted = (normal - cross.T @ np.linalg.solve(free, cross)) / scale_seen(fit.chi2)
    return normal + prior - cross.T @ inner[:, :d], slope, doubted + prior


def scale_seen(chi2: float) -> float:
    """What is left over says how far the discrepancy is from the one believed: as much as was known of it before."""
    known, seen = POSE_DEGREES_OF_FREEDOM, CHI2_DEGREES_OF_FREEDOM
    return (known + seen * chi2) / (known + seen)


def _add_prior(hill: Hill, normal: Array, pull: Array, pose: Poses, sun: Array) -> None:
    told, d = hill.told, 6 + pose.joints.shape[1]
    weak = np.concatenate([np.full(3, 1.0), np.full(2, 1e-4), [1.0], np.full(d - 6, 1e-4)])
    normal[range(d), range(d)] += weak  # far wider than any image allows: it keeps the matrix regular
    if told.log_scale is not None:
        normal[5, 5] += told.log_scale_sigma**-2
        pull[5] += (told.log_scale - float(pose.log_scale[0])) / told.log_scale_sigma**2
    if hill.sun_free:
        known = told.towards_sun is not None
        normal[range(d, d + 2), range(d, d + 2)] += told.sun_sigma**-2 if known else 1.0
        if told.towards_sun is not None:
            pull[d : d + 2] += across(sun) @ (told.towards_sun - sun) / told.sun_sigma**2


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


def _slopes(hill: Hill, poses: Poses, suns: Array, fits: list[Fit]) -> NDArray[np.float32]:
    """(N, D, S, S) derivatives of the models' images."""
    blur = hill.scene.point_spread, hill.scene.smoothing
    shares = np.stack([fit.coefficients for fit in fits])
    given = hill.drawing, hill.view, hill.quality, blur, poses, suns, shares
    return derivatives(*given, difference=hill.difference, sun_free=hill.sun_free)


def _moved(poses: Poses, suns: Array, moves: Array, hill: Hill) -> tuple[Poses, Array]:
    """Poses and Suns after their steps, joints kept in range."""
    d = 6 + poses.joints.shape[1]
    moved = retract(poses, moves[:, :d])
    moved = Poses(moved.quaternion, moved.position, moved.log_scale, within(hill.drawing, moved.joints))
    if not hill.sun_free:
        return moved, suns.copy()
    turned = np.stack([sun + move[d:] @ across(sun) for sun, move in zip(suns, moves, strict=True)])
    return moved, turned / np.linalg.norm(turned, axis=1, keepdims=True)


def within(drawing: Drawing, joints: Array) -> Array:
    """(N, J) values brought back into their range: those that turn all the way wrap, others stop."""
    values = joints.copy()
    for k, joint in enumerate(drawing.articulation.joints):
        span = joint.maximum - joint.minimum
        if joint.kind == "revolute" and span >= 359.0:
            values[:, k] = (values[:, k] - joint.minimum) % span + joint.minimum
        else:
            values[:, k] = np.clip(values[:, k], joint.minimum, joint.maximum)
    return values


def _replaced(poses: Poses, at: NDArray[np.intp], by: Poses) -> Poses:
    parts = [part.copy() for part in (poses.quaternion, poses.position, poses.log_scale, poses.joints)]
    for part, new in zip(parts, (by.quaternion, by.position, by.log_scale, by.joints), strict=True):
        part[at] = new
    return Poses(*parts)

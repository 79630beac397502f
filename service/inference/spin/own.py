"""Each frame's own likelihood, divided out of what the filter has stored (docs/motion.md).

A filtered posterior holds all earlier frames. It is likelihood times prediction, and both are Gaussians about each
mode, so the likelihood's information is the difference of theirs: J = C^-1 - P^-1, and its top lies at
x + J^-1 P^-1 (x - p), with x, C the posterior's mode and scale and p, P the prediction's.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from service.inference.belief import Belief
from service.inference.domain import Domain
from service.inference.estimate import tangent
from service.inference.model import prior
from service.inference.model.dynamics import predicted
from service.inference.motion import MotionNoise
from service.inference.numerics.student import scale_of
from service.inference.pose import exp_so3, multiply, retract
from service.inference.state import Array

_WIDEST_RAD = 1.0  # prior: of a frame that says nothing of an axis
_SAME_RATE = 1e-6  # numerical: rad/s, between a stored rate and the one that its predecessor gives
_REACH_SIGMAS = 5.0  # numerical: a bootstrap filter's mode is that of the frame before within so many
_FASTEST_RAD = 0.5  # numerical: a frame's own top is looked for no further from the posterior's


@dataclass(frozen=True)
class Own:
    """What one frame says by itself: m modes."""

    quaternion: Array  # (m, 4) body -> camera
    covariance: Array  # (m, 3, 3) scales of Student t's, rad^2, body-side
    weight: Array  # (m,) of sum 1


def own_likelihoods(
    beliefs: Sequence[Belief | None], noise: MotionNoise, domain: Domain, *, bootstrap: bool
) -> list[Own | None]:
    """Of every frame; None where nothing is known. ``bootstrap``: beliefs are clusters of particles, which jitter."""
    found: list[Own | None] = []
    before: Belief | None = None
    for belief in beliefs:
        found.append(None if belief is None else _own(belief, before, noise, domain, bootstrap))
        before = belief or before
    return found


def _own(belief: Belief, before: Belief | None, noise: MotionNoise, domain: Domain, bootstrap: bool) -> Own:
    ahead = None if before is None else _prediction(before, max(belief.time_s - before.time_s, 0.0), noise, bootstrap)
    quaternion, covariance, logs = [], [], []
    for k in range(len(belief)):
        d = belief.n_tangent
        posterior = _scale(belief.covariance[k][:d, :d], bootstrap)
        source = None if ahead is None else _source(belief, k, ahead, domain, bootstrap)
        pull: Array = np.zeros(d)
        log = float(belief.log_weights[k])
        if ahead is None or source is None:
            information = _inverse(posterior)
            if ahead is not None:  # a birth is weighed beside the leader
                log -= ahead.weight_kept * float(ahead.belief.log_weights.max()) + float(np.log(prior.BIRTH))
        else:
            j, shift = source
            expected = _inverse(ahead.covariance[j])
            information = _inverse(posterior) - expected
            log -= ahead.weight_kept * float(ahead.belief.log_weights[j])
            pull = expected @ shift
        spread = _inverse(_kept_positive(information, posterior))[:3]
        turn = spread @ pull
        turn *= min(1.0, _FASTEST_RAD / max(float(np.linalg.norm(turn)), 1e-9))
        quaternion.append(multiply(belief.poses.quaternion[k], exp_so3(turn)))
        covariance.append(_bounded(spread[:, :3]))
        logs.append(log)
    weight = np.exp(np.array(logs) - np.logaddexp.reduce(logs))
    return Own(np.array(quaternion), np.array(covariance), weight)


@dataclass(frozen=True)
class _Ahead:
    """A belief carried to the next frame."""

    belief: Belief
    dt_s: float
    covariance: Array  # (K, d, d) scales of the poses
    whole: Array  # (K, 2d, 2d)
    weight_kept: float


def _prediction(before: Belief, dt_s: float, noise: MotionNoise, bootstrap: bool) -> _Ahead:
    d = before.n_tangent
    whole: Array = np.stack([_scale(one, bootstrap) for one in before.covariance])
    if bootstrap:
        return _Ahead(before, dt_s, whole[:, :d, :d] + np.diag(noise.jitter * dt_s + 1e-12), whole, 1.0)
    whole = np.stack([predicted(one, noise, dt_s) for one in whole])
    return _Ahead(before, dt_s, whole[:, :d, :d], whole, prior.EVIDENCE_KEPT)


def _source(belief: Belief, k: int, ahead: _Ahead, domain: Domain, bootstrap: bool) -> tuple[int, Array] | None:
    """The mode that this one was, and how far it moved from where it was expected; None for one newly born."""
    before, d, pose = ahead.belief, belief.n_tangent, belief.poses[k : k + 1]
    carried = before.poses if bootstrap else retract(before.poses, before.rates * ahead.dt_s)
    shifts = np.concatenate([tangent(carried[j : j + 1], pose, domain.wrapping) for j in range(len(before))])
    if bootstrap:
        squares = np.array([s @ np.linalg.solve(c, s) for s, c in zip(shifts, ahead.covariance, strict=True)])
        j = int(np.argmin(squares))
        return (j, shifts[j]) if squares[j] < d * _REACH_SIGMAS**2 else None
    if not np.any(belief.covariance[k][:d, d:]):
        return None  # rates and pose of a birth are independent
    gains = [np.linalg.solve(one[:d, :d], one[:d, d:]).T for one in ahead.whole]
    expected = before.rates + np.array([gain @ shift for gain, shift in zip(gains, shifts, strict=True)])
    off = np.linalg.norm((expected - belief.rates[k])[:, :3], axis=1)
    j = int(np.argmin(off))
    return (j, shifts[j]) if off[j] < _SAME_RATE else None


def _scale(covariance: Array, bootstrap: bool) -> Array:
    """Of a belief's covariance: that of a Student t's own matrix, where it was one."""
    if bootstrap:
        return covariance + 1e-12 * np.eye(len(covariance))
    return scale_of(covariance, prior.POSE_DEGREES_OF_FREEDOM)


def _kept_positive(information: Array, posterior: Array) -> Array:
    """The information with what rounding has made negative taken out, in units of the posterior's spreads."""
    size = np.sqrt(np.diag(posterior))
    values, vectors = np.linalg.eigh(0.5 * (information + information.T) * np.outer(size, size))
    return np.asarray((vectors * np.maximum(values, 1e-4)) @ vectors.T / np.outer(size, size))


def _inverse(matrix: Array) -> Array:
    return np.asarray(np.linalg.inv(matrix), dtype=np.float64)


def _bounded(covariance: Array) -> Array:
    values, vectors = np.linalg.eigh(covariance)
    return np.asarray((vectors * np.clip(values, 0.0, _WIDEST_RAD**2)) @ vectors.T)

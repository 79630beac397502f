"""Where a pass's motion may lie: candidates from pairs of modes, followed over windows of time that double."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from service.inference.pose import angle_between, conjugate, log_so3, multiply
from service.inference.spin.climb import MotionPrior, climb, log_posterior
from service.inference.spin.frames import PassFrames
from service.inference.spin.rigid_body import (
    FARTHEST_RAD,
    N_INERTIA,
    Motions,
    at_other_time,
    orientations,
    places,
    stacked,
)
from service.inference.state import Array

_ANCHORS = 3  # numerical: frames that candidates begin at; the sharpest of each third of the pass
_LEAST_SHARE = 0.02  # numerical: of a mode that a candidate begins at
_NEIGHBOURS = (1, 2, 4, 8)  # numerical: frames either side of an anchor that give a rate
_FASTEST_SIGMAS = 3.0  # numerical: a turn between two frames is thought of up to this rate
_TRIED, _FOLLOWED, _TUMBLING, _SHAPES = 400, 24, 6, 4  # numerical: candidates
_FIRST, _THINNED = 9, 48  # numerical: frames of the first window, and of any
_TURNS = 8  # numerical: whole ones between two frames, at the most
_ROUNDS = 4  # numerical: steps in each window
_SAME_RAD = 0.03  # numerical: candidates that are nowhere further apart are one
# numerical: nats below the best, counted as if frames erred each by itself: that is given up
_HOPELESS = 60.0


def candidates(frames: PassFrames, prior: MotionPrior, *, tumbling: bool, reference_s: float) -> Motions:
    """Motions that explain the pass, or parts of it, told at ``reference_s``; the best of each anchor first."""
    found = [_from_anchor(frames, prior, int(k), tumbling, reference_s) for k in anchors(frames)]
    return stacked(*found)


def anchors(frames: PassFrames) -> Array:
    """The frame that says most in each third of the pass."""
    says = np.max(frames.log_weight + np.linalg.slogdet(frames.root)[1], axis=1)
    parts = np.array_split(np.arange(len(frames)), min(_ANCHORS, len(frames)))
    return np.array([part[np.argmax(says[part])] for part in parts])


def _from_anchor(frames: PassFrames, prior: MotionPrior, k: int, tumbling: bool, reference_s: float) -> Motions:
    at = float(frames.time_s[k])
    near = _window(frames, at, 0)
    motions = pairs(frames, prior, k)
    motions = _best(motions, log_posterior(near, motions, prior, at), near.time_s - at, _TRIED // 4)
    motions, score = climb(near, motions, prior, at, _ROUNDS)
    motions = _best(motions, score, near.time_s - at, _TUMBLING if tumbling else _FOLLOWED)
    if tumbling:
        motions = _with_shapes(motions, prior)
    stage, last = 0, len(near)
    while len(motions) and last < len(frames):
        stage += 1
        window, last = _window(frames, at, stage), _count(len(frames), stage)
        motions, score = climb(window, motions, prior, at, _ROUNDS)
        motions = _best(motions, score, window.time_s - at, 2 * _TUMBLING if tumbling else _FOLLOWED)
    return at_other_time(motions, reference_s - at) if len(motions) else motions


def pairs(frames: PassFrames, prior: MotionPrior, k: int) -> Motions:
    """Constant rates that lead from a mode of frame ``k`` to one of a near frame, with whole turns added, and rest."""
    most = _FASTEST_SIGMAS * prior.rate_sigma
    firsts = np.flatnonzero(frames.log_weight[k, : frames.n_starts] > np.log(_LEAST_SHARE))
    q, rates = [frames.quaternion[k, m] for m in firsts], [np.zeros(3)] * len(firsts)
    own = np.flatnonzero(frames.station == frames.station[k])  # another telescope's frame may be of the same moment
    place = int(np.searchsorted(own, k))
    near = {place + sign * step for step in _NEIGHBOURS for sign in (1, -1)} & set(range(len(own)))
    for j in own[sorted(near)]:
        dt_s = float(frames.time_s[j] - frames.time_s[k])
        if dt_s == 0.0:
            continue
        for m in firsts:
            for other in np.flatnonzero(frames.log_weight[j] > np.log(_LEAST_SHARE)):
                turn = log_so3(multiply(conjugate(frames.quaternion[k, m]), frames.quaternion[j, other]))
                angle = float(np.linalg.norm(turn))
                axis = turn / angle if angle > 1e-9 else np.array([1.0, 0.0, 0.0])
                whole = int(min(most * abs(dt_s) / (2 * np.pi), _TURNS))
                for n in range(-whole - 1, whole + 1):
                    rate = (angle + 2 * np.pi * n) / dt_s
                    if abs(rate) <= most:
                        q.append(frames.quaternion[k, m])
                        rates.append(rate * axis)
    order = np.argsort(np.linalg.norm(rates, axis=1), kind="stable")[:_TRIED]
    return Motions(np.array(q)[order], np.array(rates)[order], np.zeros((len(order), 0)))


def _with_shapes(motions: Motions, prior: MotionPrior) -> Motions:
    """Each candidate with several bodies of the prior."""
    rng = np.random.default_rng(0)
    shapes = np.concatenate([np.zeros((1, N_INERTIA)), rng.standard_normal((_SHAPES - 1, N_INERTIA))])
    shapes = prior.shape + prior.shape_sigma * shapes
    count = len(motions)
    at = np.repeat(np.arange(count), _SHAPES)
    return Motions(motions.quaternion[at], motions.rate[at], np.tile(shapes, (count, 1)))


def _count(whole: int, stage: int) -> int:
    return int(min(whole, _FIRST * 2**stage))


def _window(frames: PassFrames, at_s: float, stage: int) -> PassFrames:
    """The frames nearest in time to ``at_s``, twice as many in each stage, thinned evenly."""
    nearest = np.argsort(np.abs(frames.time_s - at_s), kind="stable")[: _count(len(frames), stage)]
    chosen = np.sort(nearest)
    return frames[chosen[np.unique(np.linspace(0, len(chosen) - 1, _THINNED).round().astype(int))]]


def _best(motions: Motions, score: Array, elapsed_s: Array, most: int) -> Motions:
    """The highest, each once; none that a free body would have to be followed too far."""
    if motions.shape.shape[1]:
        near = np.linalg.norm(motions.rate, axis=1) * np.max(np.abs(elapsed_s)) < FARTHEST_RAD
        motions, score = motions[near], score[near]
    return motions[distinct(motions, score, elapsed_s, most)]


def distinct(motions: Motions, score: Array, elapsed_s: Array, most: int) -> NDArray[np.intp]:
    """Indices of the highest candidates that differ somewhere in a window, highest first."""
    if not len(motions):
        return np.zeros(0, dtype=np.intp)
    q = orientations(motions, places(float(elapsed_s[0]), float(elapsed_s[-1])))
    kept: list[int] = []
    for k in np.argsort(-score, kind="stable"):
        if len(kept) == most or score[k] < score.max() - _HOPELESS:
            break
        if not any(float(angle_between(q[k], q[j]).max()) < _SAME_RAD for j in kept):
            kept.append(int(k))
    return np.array(kept, dtype=np.intp)

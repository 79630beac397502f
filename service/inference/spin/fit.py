"""A pass's motion: the tops of both hypotheses, each with its evidence and moments (docs/motion.md)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from service.inference.spin.basins import Basin, Bodies, PassMotion, same_course
from service.inference.spin.climb import OUTLIER, MotionPrior, climb, shares
from service.inference.spin.frames import DEGREES, LOG_UNIFORM, PassFrames, gaps
from service.inference.spin.noise import Linear, solve
from service.inference.spin.rigid_body import Motions, moved, with_derivatives
from service.inference.spin.starts import candidates, distinct
from service.inference.state import Array

TUMBLING = 0.25  # prior: friction inside brings a body to turn about one axis, and control holds most
FREE_SHAPE_SIGMA = 1.0  # prior: log second moments of a body of which nothing is known
MESH_SHAPE_SIGMA = 0.4  # prior: of a body whose mesh is known and whose masses are not: within a factor 1.5
LEAST_FRAMES = 3  # contract: below it there is no motion to tell
_BASINS = 6  # numerical: of a hypothesis
_ROUNDS = (6, 20)  # numerical: steps of all candidates, then of those that are left
_FRAMES = 1500  # numerical: of longer passes so many are taken, evenly
_REWEIGHED = 3  # numerical: rounds of weights, linearisation and solution
_LEAST_PRECISION = 1e-6  # numerical: rad^-2, of an orientation that may be any


def fit_pass(
    frames: PassFrames, rate_sigma: float, mesh_shape: Array | None = None, rotations: Sequence[Array] = ()
) -> PassMotion:
    """The posterior over motions of a pass of ``LEAST_FRAMES`` or more; no basins where none explains so many.

    ``rate_sigma`` (rad/s, each axis): of a rate of which nothing is known. ``mesh_shape`` (5,): the body's shape by
    its mesh. ``rotations`` (4,) each: q s is seen as q is, for each of them; such motions are told once.
    """
    reference_s = 0.5 * float(frames.time_s[0] + frames.time_s[-1])
    half_span_s = 0.5 * float(frames.time_s[-1] - frames.time_s[0])
    bodies: dict[Bodies, MotionPrior] = {"free": MotionPrior(rate_sigma, np.zeros(5), FREE_SHAPE_SIGMA)}
    if mesh_shape is not None:
        bodies["mesh"] = MotionPrior(rate_sigma, mesh_shape, MESH_SHAPE_SIGMA)
    basins: list[Basin] = []
    for tumbling in (False, True):
        widest = bodies.get("mesh", bodies["free"])
        start = candidates(frames, widest, tumbling=tumbling, reference_s=reference_s)
        tops = _climbed(frames, start, widest, reference_s)
        tops = tops[once(tops, rotations, half_span_s)]
        priors: dict[Bodies, MotionPrior] = bodies if tumbling else {"free": bodies["free"]}
        log_prior = np.log(TUMBLING / len(priors)) if tumbling else np.log(1 - TUMBLING)
        for name, body in priors.items():
            found = [weighed(frames, tops[k : k + 1], body, reference_s, name) for k in range(len(tops))]
            basins += [replace(one, log_evidence=one.log_evidence + float(log_prior)) for one in found if one]
    ranked = _ranked(basins, reference_s, half_span_s, len(frames))
    return replace(ranked, rotations=tuple(rotations))


def evenly(count: int, stations: int = 1) -> NDArray[np.intp]:
    """Numbers of the frames that are taken of ``count``: all, or of a long pass so many that it takes seconds."""
    return np.unique(np.linspace(0, count - 1, min(count, _FRAMES // stations)).round().astype(np.intp))


def _ranked(basins: list[Basin], reference_s: float, half_span_s: float, n_frames: int) -> PassMotion:
    """Most probable first. One law of errors for all: how many frames count is what it says of the best."""
    if not basins:
        return PassMotion(reference_s, half_span_s, (), np.zeros(0), n_frames)
    log = np.array([basin.log_evidence for basin in basins])
    lead = basins[int(np.argmax(log))]
    log += lead.independent / (lead.explained * n_frames) * np.array([basin.log_weights for basin in basins])
    order = np.argsort(-log, kind="stable")
    probabilities = np.exp(log - np.logaddexp.reduce(log))[order]
    return PassMotion(reference_s, half_span_s, tuple(basins[k] for k in order), probabilities, n_frames)


def _climbed(frames: PassFrames, start: Motions, prior: MotionPrior, reference_s: float) -> Motions:
    """The distinct tops that are within reach of the highest, highest first."""
    for rounds in _ROUNDS if len(start) else ():
        start, score = climb(frames, start, prior, reference_s, rounds)
        start = start[distinct(start, score, frames.time_s - reference_s, _BASINS)]
    return start


def once(tops: Motions, rotations: Sequence[Array], half_span_s: float) -> NDArray[np.intp]:
    """Indices of tops that are not another one seen through a symmetry of the body."""
    kept: list[int] = []
    for k in range(len(tops)):
        if not any(same_course(tops[k : k + 1], tops[j : j + 1], half_span_s, rotations) for j in kept):
            kept.append(k)
    return np.array(kept, dtype=np.intp)


def weighed(
    frames: PassFrames, motion: Motions, prior: MotionPrior, reference_s: float, bodies: Bodies = "free"
) -> Basin | None:
    """The posterior about one top, with frames that err alike (``noise``); None where too few frames are of it."""
    precision = prior.precision(motion)
    precision[:3] = _LEAST_PRECISION
    rows, solved, told = np.arange(len(frames)), None, None
    for _ in range(_REWEIGHED):
        q, jacobian = with_derivatives(motion, frames.time_s - reference_s)
        share = shares(frames, q)[0]
        mode, used = np.argmax(share, axis=1), share.sum(axis=1) > 0.5
        if used.sum() < LEAST_FRAMES:
            return None
        told = rows[used], mode[used]
        z = gaps(frames, q)[0][told]
        same = solved is not None and len(solved.own_squares) == len(z)
        squares = solved.own_squares if solved is not None and same else np.sum(z**2, axis=1)
        u = (DEGREES + 3) / (DEGREES + squares)
        away = prior.away(motion)[0]
        linear = Linear(
            frames.time_s[used], z, frames.root[told] @ jacobian[0][used], u, precision, away, frames.station[used]
        )
        solved = solve(linear)
        log = solved.log_evidence + float(prior.log_density(motion)[0])
        motion = moved(motion, solved.mean[None])
    assert solved is not None and told is not None
    return Basin(
        model="tumbling" if motion.shape.shape[1] else "constant_rate",
        bodies=bodies,
        motion=motion,
        covariance=solved.covariance,
        log_evidence=log + _log_frames(frames, told, u),
        log_weights=float(np.sum(frames.log_weight[told])),
        explained=len(told[0]) / len(frames),
        scale=solved.scale,
        independent=solved.independent,
    )


def _log_frames(frames: PassFrames, told: tuple[NDArray[np.intp], NDArray[np.intp]], u: Array) -> float:
    """Heights of the frames' modes, the law of the weights u (Gamma of half of ``DEGREES``), and the outliers."""
    count, left = len(u), len(frames) - len(u)
    log = float(np.sum(np.linalg.slogdet(frames.root[told])[1]))
    log += float(np.sum(0.5 * DEGREES * (np.log(u) - u + 1)))
    return log + count * float(np.log(1 - OUTLIER)) + left * (float(np.log(OUTLIER)) + LOG_UNIFORM)

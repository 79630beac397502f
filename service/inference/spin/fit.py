"""A pass's motion: basins of both hypotheses, each with evidence, moments, and the frames that it explains."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from service.inference.spin.climb import OUTLIER, MotionPrior, climb, log_posterior, shares
from service.inference.spin.frames import DEGREES, LOG_UNIFORM, PassFrames, gaps
from service.inference.spin.noise import Linear, solve
from service.inference.spin.rigid_body import Motions, moved, with_derivatives
from service.inference.spin.starts import candidates, distinct
from service.inference.state import Array

Model = Literal["constant_rate", "tumbling"]
TUMBLING = 0.25  # prior: friction inside brings a body to turn about one axis, and control holds most
FREE_SHAPE_SIGMA = 1.0  # prior: log second moments of a body of which nothing is known
MESH_SHAPE_SIGMA = 0.4  # prior: of a body whose mesh is known and whose masses are not: within a factor 1.5
_BASINS = 6  # numerical: of a hypothesis
_ROUNDS = 40
_FRAMES = 1500  # numerical: of longer passes so many are taken, evenly
_RELINEARISED = 3  # numerical: rounds of reweighting and linearisation
_LEAST_PRECISION = 1e-6  # numerical: rad^-2, of an orientation that may be any


@dataclass(frozen=True)
class Basin:
    """One motion that may be true. P = 6 (turn in fixed axes, rate) or 11 (and shape)."""

    model: Model
    motion: Motions  # one, at the pass's reference time
    covariance: Array  # (P, P) of the steps of ``moved``
    log_evidence: float  # but for what the frames say of one mode against another
    log_weights: float  # the sum of that over the frames
    explained: float  # share of the frames
    scale: float  # stated spreads are to be multiplied by it
    independent: float  # frames, were each to err by itself


@dataclass(frozen=True)
class PassMotion:
    """What is known of the motion: basins, most probable first, with their probabilities."""

    reference_s: float
    basins: tuple[Basin, ...]
    probabilities: Array  # (K,)
    frames: int  # used

    def probability_of(self, model: Model) -> float:
        """Of a hypothesis."""
        return float(sum(p for p, b in zip(self.probabilities, self.basins, strict=True) if b.model == model))


def fit_pass(frames: PassFrames, rate_sigma: float, mesh_shape: Array | None = None) -> PassMotion:
    """The posterior over motions of a pass of at least three frames."""
    if len(frames) > _FRAMES:
        frames = frames[np.linspace(0, len(frames) - 1, _FRAMES).round().astype(int)]
    reference_s = 0.5 * float(frames.time_s[0] + frames.time_s[-1])
    free = MotionPrior(rate_sigma, np.zeros(5), FREE_SHAPE_SIGMA)
    bodies = [free] if mesh_shape is None else [free, MotionPrior(rate_sigma, mesh_shape, MESH_SHAPE_SIGMA)]
    basins: list[Basin] = []
    for tumbling in (False, True):
        start = candidates(frames, bodies[-1], tumbling=tumbling, reference_s=reference_s)
        found = _climbed(frames, start, bodies[-1], reference_s)
        for body in bodies if tumbling else bodies[:1]:
            share = np.log(TUMBLING / len(bodies)) if tumbling else np.log(1 - TUMBLING)
            for k in range(len(found)):
                basin = weighed(frames, found[np.array([k])], body, reference_s)
                basins.append(replace(basin, log_evidence=basin.log_evidence + float(share)))
    log = np.array([basin.log_evidence for basin in basins])
    lead = basins[int(np.argmax(log))]  # one law of errors for all: what it says of the frames' number is the best's
    log += lead.independent / (lead.explained * len(frames)) * np.array([basin.log_weights for basin in basins])
    order = np.argsort(-log, kind="stable")
    probabilities = np.exp(log - np.logaddexp.reduce(log))[order]
    return PassMotion(reference_s, tuple(basins[k] for k in order), probabilities, len(frames))


def _climbed(frames: PassFrames, start: Motions, prior: MotionPrior, reference_s: float) -> Motions:
    """The distinct tops that are within reach of the highest."""
    elapsed = frames.time_s - reference_s
    for rounds in (6, _ROUNDS):
        start, score = climb(frames, start, prior, reference_s, rounds)
        start = start[distinct(start, score, elapsed, _BASINS)]
    return start


def weighed(frames: PassFrames, motion: Motions, prior: MotionPrior, reference_s: float) -> Basin:
    """The posterior about one top, with frames that err alike (``noise``)."""
    elapsed = frames.time_s - reference_s
    precision = prior.precision(motion)
    precision[:3] = _LEAST_PRECISION
    solved = None
    for _ in range(_RELINEARISED):
        q, jacobian = with_derivatives(motion, elapsed)
        away = gaps(frames, q)[0]
        share = shares(frames, q)[0]
        mode = np.argmax(share, axis=1)
        rows = np.arange(len(frames))
        used = share.sum(axis=1) > 0.5
        if used.sum() < 3:
            break
        z = away[rows, mode]
        root = frames.root[rows, mode]
        squares = np.sum(z**2, axis=1)
        if solved is not None and len(solved.own_squares) == used.sum():
            squares[used] = solved.own_squares
        u = (DEGREES + 3) / (DEGREES + squares)
        linear = Linear(
            frames.time_s[used], z[used], root[used] @ jacobian[0][used], u[used], precision, prior.away(motion)[0]
        )
        solved = solve(linear)
        motion = moved(motion, solved.mean[None])
    if solved is None:
        return Basin(_model(motion), motion, np.diag(1 / precision), -np.inf, 0.0, 0.0, 1.0, 0.0)
    log = solved.log_evidence + float(prior.log_density(motion)[0]) + 0.5 * float(
        np.sum(precision * prior.away(motion)[0] ** 2)
    )
    log += float(np.sum(np.linalg.slogdet(root[used])[1]))
    log += float(np.sum(0.5 * DEGREES * (np.log(u[used]) - u[used] + 1)))
    told = float(np.sum(frames.log_weight[rows, mode][used]))
    log += used.sum() * np.log(1 - OUTLIER) + (~used).sum() * (np.log(OUTLIER) + LOG_UNIFORM)
    return Basin(_model(motion), motion, solved.covariance, log, told, float(used.mean()), solved.scale, solved.independent)


def _model(motion: Motions) -> Model:
    return "tumbling" if motion.shape.shape[1] else "constant_rate"

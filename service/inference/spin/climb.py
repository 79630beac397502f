"""Motions at their best: Gauss-Newton on the manifold, frames weighed by what they say of each candidate."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from service.inference.spin.frames import DEGREES, LOG_UNIFORM, PassFrames, gaps, log_densities
from service.inference.spin.rigid_body import Motions, moved, orientations, with_derivatives
from service.inference.state import Array

OUTLIER = 0.05  # prior: share of frames of which no mode is true; of tracked passes one search in twenty errs
SLOWEST = float(np.deg2rad(0.02))  # prior: rad/s, below which a rate is as good as none: a turn in five hours
_SHORTER, _LEAST_SHARE = 0.3, 0.02  # numerical: of a step that did not climb; steps shorter than that are given up
_ENOUGH = 1e-3  # numerical: nats: a step that gains less is the last


@dataclass(frozen=True)
class MotionPrior:
    """What is believed of a motion before a frame is seen; the orientation may be any."""

    rate_sigma: float  # rad/s, each axis
    shape: Array  # (5,) mean of ``Motions.shape``
    shape_sigma: float  # of each of its entries

    def log_density(self, motions: Motions) -> Array:
        """(B,) per rad^3 of orientation, (rad/s)^3 of rate, and shape.

        The order of magnitude of a rate is unknown: its log is uniform from ``SLOWEST`` to three ``rate_sigma``, its
        direction is any; below ``SLOWEST`` its density is flat.
        """
        squares = np.sum(motions.rate**2, axis=1) + SLOWEST**2
        rate = -np.log(4 * np.pi * np.log(3 * self.rate_sigma / SLOWEST)) - 1.5 * np.log(squares)
        rate -= 0.5 * np.maximum(np.sqrt(squares) / self.rate_sigma - 3, 0) ** 2
        x = self.away(motions)[:, 6:] / self.shape_sigma
        shape = -0.5 * np.sum(x**2, axis=1) - x.shape[1] * (np.log(self.shape_sigma) + 0.5 * np.log(2 * np.pi))
        return np.asarray(LOG_UNIFORM + rate + shape)

    def precision(self, motions: Motions) -> Array:
        """(P,) diagonal, of the steps of ``moved``; of the rate that of its widest law, which no pass comes near."""
        count = motions.shape.shape[1]
        return np.array([0.0] * 3 + [self.rate_sigma**-2] * 3 + [self.shape_sigma**-2] * count)

    def away(self, motions: Motions) -> Array:
        """(B, P) steps from the mean."""
        shape = motions.shape - self.shape if motions.shape.shape[1] else motions.shape
        return np.concatenate([np.zeros((len(motions), 3)), motions.rate, shape], axis=1)


def log_posterior(frames: PassFrames, motions: Motions, prior: MotionPrior, reference_s: float) -> Array:
    """(B,) log of prior and likelihoods, every frame as if it erred by itself."""
    q = orientations(motions, frames.time_s - reference_s)
    return np.asarray(np.sum(_log_frames(frames, q)[0], axis=1) + prior.log_density(motions))


def shares(frames: PassFrames, q: Array) -> Array:
    """(B, n, M) probabilities of the modes under orientations (B, n, 4); what is missing from 1 is an outlier's."""
    log_frame, log_mode, _ = _log_frames(frames, q)
    return np.exp(log_mode - log_frame[..., None])


def climb(
    frames: PassFrames, motions: Motions, prior: MotionPrior, reference_s: float, rounds: int
) -> tuple[Motions, Array]:
    """B candidates after at most ``rounds`` steps, and their log posteriors (B,)."""
    elapsed = frames.time_s - reference_s
    score = log_posterior(frames, motions, prior, reference_s)
    share = np.ones(len(motions))
    going = np.ones(len(motions), dtype=bool)
    for _ in range(rounds):
        at = np.flatnonzero(going)
        if not len(at):
            break
        normal, pull = _system(frames, motions[at], prior, elapsed)
        step = np.linalg.solve(normal, pull[..., None])[..., 0] * share[at, None]
        trial = moved(motions[at], step)
        after = log_posterior(frames, trial, prior, reference_s)
        better = after > score[at]
        gain = np.where(better, after - score[at], np.inf)
        motions = _replaced(motions, at[better], trial[better])
        score[at[better]] = after[better]
        share[at] = np.where(better, np.minimum(1.0, 2 * share[at]), _SHORTER * share[at])
        going[at] = (gain > _ENOUGH) & (share[at] > _LEAST_SHARE)
    return motions, score


def _log_frames(frames: PassFrames, q: Array) -> tuple[Array, Array, Array]:
    """Log likelihoods of the frames (B, n), of their modes (B, n, M), and whitened gaps (B, n, M, 3)."""
    away = gaps(frames, q)
    log_mode = np.log(1 - OUTLIER) + log_densities(frames, np.sum(away**2, axis=-1))
    highest = np.maximum(log_mode.max(axis=-1), LOG_UNIFORM)
    total = np.sum(np.exp(log_mode - highest[..., None]), axis=-1) + OUTLIER * np.exp(LOG_UNIFORM - highest)
    return highest + np.log(total), log_mode, away


def _system(frames: PassFrames, motions: Motions, prior: MotionPrior, elapsed_s: Array) -> tuple[Array, Array]:
    """(B, P, P) curvature and (B, P) slope of the log posterior."""
    q, jacobian = with_derivatives(motions, elapsed_s)
    log_frame, log_mode, away = _log_frames(frames, q)
    squares = np.sum(away**2, axis=-1)
    weight = np.exp(log_mode - log_frame[..., None]) * (DEGREES + 3) / (DEGREES + squares)
    information = np.einsum("bnm,nmij,nmjk->bnik", weight, frames.root, frames.root)
    slope = -np.einsum("bnm,nmij,bnmj->bni", weight, frames.root, away)
    normal = np.einsum("bnip,bnij,bnjq->bpq", jacobian, information, jacobian, optimize=True)
    pull = np.einsum("bnip,bni->bp", jacobian, slope)
    sure = prior.precision(motions)
    sure[:3] = 1e-6  # numerical: the orientation may be any, and no frame may tell it
    count = len(sure)
    normal[:, range(count), range(count)] += sure
    return normal, pull - np.concatenate([np.zeros(3), sure[3:]]) * prior.away(motions)


def _replaced(motions: Motions, at: NDArray[np.intp], by: Motions) -> Motions:
    parts = [part.copy() for part in (motions.quaternion, motions.rate, motions.shape)]
    for part, new in zip(parts, (by.quaternion, by.rate, by.shape), strict=True):
        part[at] = new
    return Motions(*parts)

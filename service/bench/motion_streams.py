"""Passes as streams of what frames say, without images: the truth drawn from the priors of docs/motion.md."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from service.inference.pose import conjugate, exp_so3, multiply
from service.inference.spin.basins import nutation
from service.inference.spin.frames import DEGREES, PassFrames, pass_frames
from service.inference.spin.noise import SCALE_LOG_SIGMA
from service.inference.spin.rigid_body import N_INERTIA, Motions, orientations
from service.inference.state import Array

_STAYS = (0.0, 0.1, 0.25, 0.5)  # share of the errors' variance that stays
_LASTS_S = (0.3, 1.0, 3.0, 10.0, 30.0)
_SIGMAS_DEG = (0.2, 2.0)  # of a frame, log-uniform: calm air, and D/r0 of 4
_MISSED = 0.04  # share of frames whose modes are all wrong
_TWIN = conjugate(np.array([0.0, 0.0, 1.0, 0.0]))  # a body that looks alike from behind


@dataclass(frozen=True)
class StreamPlan:
    """How long a pass is, and how fast bodies turn."""

    frames: int = 300
    span_s: float = 60.0
    rates_deg_s: tuple[float, float] = (0.05, 10.0)  # log-uniform
    shape_sigma: float = 0.7  # of a tumbling body's log second moments
    least_nutation_deg: float = 0.0  # of a tumbling body


@dataclass(frozen=True)
class Stream:
    """A pass and its truth, told at its middle."""

    frames: PassFrames
    truth: Motions
    sigma_deg: float
    stays: float
    lasts_s: float


def draw_stream(rng: np.random.Generator, plan: StreamPlan, *, tumbling: bool) -> Stream:
    """One pass of a motion told at its middle."""
    times = np.linspace(0.0, plan.span_s, plan.frames)
    truth = draw_motion(rng, plan, tumbling=tumbling)
    seen = seen_stream(rng, times, orientations(truth, times - plan.span_s / 2)[0])
    return Stream(seen.frames, truth, seen.sigma_deg, seen.stays, seen.lasts_s)


@dataclass(frozen=True)
class Seen:
    """What frames say, and how they err."""

    frames: PassFrames
    sigma_deg: float
    stays: float
    lasts_s: float


def seen_stream(rng: np.random.Generator, times: Array, q: Array, told: tuple[float, float] | None = None) -> Seen:
    """Frames of orientations (n, 4): each has the truth and its twin as modes, and errs alike with its neighbours.

    ``told``: what frames state, degrees, and how much more they err than that; None: drawn.
    """
    sigma_deg, scatter = drawn_quality(rng) if told is None else told
    stays, lasts_s = float(rng.choice(_STAYS)), float(rng.choice(_LASTS_S))
    widths = np.deg2rad(sigma_deg) * np.exp(rng.normal(0.0, 0.4, 3))
    smooth = bool(rng.random() < 0.5)
    errors = draw_errors(rng, times, stays, lasts_s, smooth=smooth) * widths * scatter
    seen = multiply(q, exp_so3(errors))
    missed = rng.random(len(times)) < _MISSED
    seen[missed] = exp_so3(rng.normal(0.0, 2.0, (int(missed.sum()), 3)))
    preferred = rng.beta(4.0, 2.0, len(times))  # of the truth's mode: one frame does not tell it from its twin
    twins = multiply(multiply(_TWIN, seen), np.array([0.0, 1.0, 0.0, 0.0]))
    modes = [np.stack(pair) for pair in zip(seen, twins, strict=True)]
    spreads = [np.stack([np.diag(widths**2)] * 2)] * len(times)
    weights = [np.array([p, 1 - p]) for p in preferred]
    return Seen(pass_frames(times, modes, spreads, weights), sigma_deg, stays, lasts_s)


def drawn_quality(rng: np.random.Generator) -> tuple[float, float]:
    """What a telescope's frames state of an orientation, degrees, and the factor by which they err more than that."""
    return float(np.exp(rng.uniform(*np.log(_SIGMAS_DEG)))), float(np.exp(rng.normal(0.0, SCALE_LOG_SIGMA)))


def draw_motion(rng: np.random.Generator, plan: StreamPlan, *, tumbling: bool) -> Motions:
    """A motion of the plan's rates and bodies."""
    while True:
        rate = rng.standard_normal(3)
        rate *= np.deg2rad(np.exp(rng.uniform(*np.log(plan.rates_deg_s)))) / np.linalg.norm(rate)
        shape = rng.normal(0.0, plan.shape_sigma, (1, N_INERTIA)) if tumbling else np.zeros((1, 0))
        start = rng.standard_normal(4)
        motion = Motions((start / np.linalg.norm(start))[None], rate[None], shape)
        if not tumbling or nutation_deg(motion) >= plan.least_nutation_deg:
            return motion


def nutation_deg(motion: Motions) -> float:
    """Between the angular velocity and the angular momentum."""
    return float(np.rad2deg(nutation(motion)[0]))


def draw_errors(rng: np.random.Generator, times: Array, stays: float, lasts_s: float, *, smooth: bool = False) -> Array:
    """(n, 3) whitened errors: a share that stays (Matern's of 1/2 or 3/2), the rest each frame's own Student t."""
    away = np.abs(times[:, None] - times) / lasts_s
    alike = (1 + np.sqrt(3) * away) * np.exp(-np.sqrt(3) * away) if smooth else np.exp(-away)
    slow = np.linalg.cholesky(alike + 1e-9 * np.eye(len(times))) @ rng.standard_normal((len(times), 3))
    own = rng.standard_normal((len(times), 3)) / np.sqrt(rng.chisquare(DEGREES, (len(times), 1)) / DEGREES)
    return np.asarray(np.sqrt(stays) * slow + np.sqrt(1 - stays) * own)

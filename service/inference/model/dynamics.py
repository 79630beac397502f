"""Motion of docs/model.md, section 5: constant rates with noise, in the tangent space of a pose."""

from __future__ import annotations

import numpy as np

from service.inference.model import prior
from service.inference.motion import MotionNoise
from service.inference.state import Array


def predicted(covariance: Array, noise: MotionNoise, dt_s: float, *, seen: bool = True) -> Array:
    """(2d, 2d) of pose and rates after ``dt_s``, from (2d, 2d).

    A frame repeats part of what the ones before said, since the body's drawing is wrong in the same places: what is
    remembered fades (a fading-memory Kalman filter), so that a spread never falls far below that of one frame.
    ``seen``: the last frame told of it; where it did not, the next one repeats nothing of it.
    """
    d = len(covariance) // 2
    onward = np.eye(2 * d)
    onward[:d, d:] = dt_s * np.eye(d)
    out = onward @ covariance @ onward.T / _kept(seen)
    out[range(d), range(d)] += noise.jitter * dt_s + noise.change * dt_s**3 / 3
    out[range(d, 2 * d), range(d, 2 * d)] += noise.change * dt_s
    out[range(d), range(d, 2 * d)] += noise.change * dt_s**2 / 2
    out[range(d, 2 * d), range(d)] += noise.change * dt_s**2 / 2
    return np.asarray(0.5 * (out + out.T))


def _kept(seen: bool) -> float:
    return prior.MEMORY_KEPT if seen else 1.0


def corrected(rates: Array, before: Array, shift: Array, pose_covariance: Array) -> tuple[Array, Array]:
    """Rates (d,) and (2d, 2d) after the pose moved by ``shift`` (d,) from its prediction, to this covariance (d, d)."""
    d = len(rates)
    gain = np.linalg.solve(before[:d, :d], before[:d, d:]).T
    out = np.empty_like(before)
    out[:d, :d] = pose_covariance
    out[d:, :d] = gain @ pose_covariance
    out[:d, d:] = out[d:, :d].T
    out[d:, d:] = before[d:, d:] - gain @ before[:d, :d] @ gain.T + gain @ pose_covariance @ gain.T
    return rates + gain @ shift, np.asarray(0.5 * (out + out.T))


def new_born(pose_covariance: Array, noise: MotionNoise) -> Array:
    """(2d, 2d) of a mode of which one frame is known."""
    d = len(pose_covariance)
    out = np.zeros((2 * d, 2 * d))
    out[:d, :d] = pose_covariance
    out[range(d, 2 * d), range(d, 2 * d)] = noise.variance
    return out


def predicted_suns(sigmas: Array, dt_s: float, *, seen: bool = True) -> Array:
    """(K,) of the Suns that go with modes, after ``dt_s``: what is remembered of them fades as poses do."""
    return np.asarray(np.sqrt(sigmas**2 / _kept(seen) + prior.SUN_DRIFT**2 * dt_s))


def turn(rates: Array, covariance: Array, dt_s: float) -> Array:
    """(K,) rad by which K bodies of rates (K, d) turn in ``dt_s``; pose and rates have (K, 2d, 2d).

    What is not known of rates is taken off: else a faint body seems to turn, whose rates are noise.
    """
    d = rates.shape[1]
    unsure = np.trace(covariance[:, d : d + 3, d : d + 3], axis1=1, axis2=2)
    return np.asarray(dt_s * np.sqrt(np.maximum(np.sum(rates[:, :3] ** 2, axis=1) - unsure, 0.0)))

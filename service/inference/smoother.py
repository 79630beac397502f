"""Backwards over a pass: what every frame looks like once all of them are known.

The filter's posterior is a sum of Gaussians over poses and rates, one per mode, and so is its prediction. Its backward
pass is therefore the Rauch-Tung-Striebel smoother (1965) of each mode, with the modes' weights carried back by how
well each one's prediction meets what came after (Kim, *Dynamic linear models with Markov-switching*, 1994, for the
weights). Choosing among the stored particles instead (Godsill, Doucet, West 2004) would need one of a thousand to lie
within the motion's narrow noise in all 12 + 2J coordinates of pose and rates: hardly two do.

Between two frames a pose moves by its rates, T' = T exp(v dt), and noise of the filter's own variances is added.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from service.inference.belief import Belief
from service.inference.domain import Domain
from service.inference.estimate import tangent
from service.inference.model.prior import NEW_MODE
from service.inference.modes import LEAST_MODE, MOST_MODES
from service.inference.motion import MotionNoise, carry_on
from service.inference.pose import concatenate, exp_so3, retract, rotation_matrices
from service.inference.state import Array, Poses
from service.inference.symmetry import Symmetry, twin, twin_rates
from service.inference.weights import log_sum_exp, second_moment

LEAST_DT_S = 1e-3  # numerical: as in the filter
_FLOOR = 1e-12  # numerical: of a variance, so that a rate that never changes can be inverted
_STEP = 1e-5  # numerical: of a difference quotient


@dataclass(frozen=True)
class Space:
    """What the smoother knows of the session."""

    motion: MotionNoise  # ``variance``: of a rate that nothing is known of
    domain: Domain
    twins: Sequence[Symmetry] = ()


@dataclass(frozen=True)
class Gaussian:
    """One mode: pose, rates (d,), covariance (2d, 2d)."""

    pose: Poses
    rate: Array
    covariance: Array


def smooth(beliefs: Sequence[Belief | None], space: Space) -> list[Belief | None]:
    """The smoothed marginal of each frame; a frame of which nothing is known stays None, and is bridged."""
    result: list[Belief | None] = [None] * len(beliefs)
    later: Belief | None = None
    for k in reversed(range(len(beliefs))):
        belief = beliefs[k]
        if belief is not None:
            later = belief if later is None else step_back(belief, later, space)
            result[k] = later
    return result


def step_back(belief: Belief, later: Belief, space: Space) -> Belief:
    """The smoothed marginal of a frame (``belief``: as filtered) before the one smoothed as ``later``."""
    dt_s = max(later.time_s - belief.time_s, LEAST_DT_S)
    forecasts = [predict(mode, dt_s, belief.widening, space.motion) for mode in modes_of(belief)]
    shares = np.zeros(len(belief))  # of the weight, by the modes that came after
    merged: list[list[tuple[float, Array, Array]]] = [[] for _ in forecasts]
    for weight, target in zip(np.exp(later.log_weights), modes_of(later), strict=True):
        images = list(alike(target, space))
        met = [forecast.meet(images, space.domain) for forecast in forecasts]
        log_shares = belief.log_weights + np.array([log_density for log_density, _, _ in met])
        log_new = float(np.log(NEW_MODE)) + _log_unknown(target.rate, space)
        total = log_sum_exp(np.append(log_shares, log_new))
        # What a search found tells nothing of where the object was before.
        stay = weight * float(np.exp(log_new - total)) * np.exp(belief.log_weights)
        for i, (_, shift, covariance) in enumerate(met):
            share = weight * float(np.exp(log_shares[i] - total))
            merged[i].append((share, shift, covariance))
            merged[i].append((float(stay[i]), np.zeros_like(shift), belief.covariance[i]))
            shares[i] += share + stay[i]
    return _collect(belief, shares, merged, space.domain)


@dataclass(frozen=True)
class Forecast:
    """A mode carried to the next frame, and what it takes to go back."""

    before: Gaussian
    after: Gaussian
    transition: Array  # (2d, 2d) F

    def meet(self, images: Sequence[Gaussian], domain: Domain) -> tuple[float, Array, Array]:
        """Log density of the forecast at the nearest of the twins ``images``, and the mode given that twin.

        The mode as its shift (2d,) in the tangent space of ``before`` and its covariance: with the gain
        G = P F' S^-1, shift = G z and P + G (P_later - S) G'.
        """
        root = np.linalg.cholesky(self.after.covariance)
        gaps = [np.concatenate([_gap(self.after, image, domain), image.rate - self.after.rate]) for image in images]
        squares = [float(np.sum(np.linalg.solve(root, gap) ** 2)) for gap in gaps]
        k = int(np.argmin(squares))
        log_density = -0.5 * (squares[k] + len(gaps[k]) * np.log(2 * np.pi)) - float(np.sum(np.log(np.diag(root))))
        prior = self.before.covariance
        gain = np.linalg.solve(self.after.covariance, self.transition @ prior).T
        covariance = prior + gain @ (images[k].covariance - self.after.covariance) @ gain.T
        return log_density, gain @ gaps[k], covariance


def predict(mode: Gaussian, dt_s: float, widening: float, motion: MotionNoise) -> Forecast:
    """Carry a mode on by its rates, with the noise that the filter's own prediction has."""
    d = len(mode.rate)
    turn = mode.rate[:3] * dt_s
    transition = np.eye(2 * d)
    transition[:d, d:] = dt_s * np.eye(d)
    transition[:3, :3] = rotation_matrices(exp_so3(turn)).T
    transition[:3, d : d + 3] = dt_s * right_jacobian(turn)
    position = (motion.jitter * dt_s + motion.change * dt_s**3 / 3) * widening**2
    together = np.diag(motion.change * dt_s**2 / 2)  # a rate that has changed has also moved the pose
    noise = np.block([[np.diag(position), together], [together, np.diag(motion.change * dt_s)]])
    covariance = transition @ mode.covariance @ transition.T + noise + _FLOOR * np.eye(2 * d)
    return Forecast(mode, Gaussian(carry_on(mode.pose, mode.rate[None], dt_s), mode.rate, covariance), transition)


def right_jacobian(vector: Array) -> Array:
    """(3, 3) J with exp(a + e) = exp(a) exp(J e) to first order in e (Chirikjian 2012, eq. 10.86)."""
    angle = float(np.linalg.norm(vector))
    x, y, z = vector
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    if angle < 1e-4:
        return np.asarray(np.eye(3) - 0.5 * cross + cross @ cross / 6, dtype=np.float64)
    first, second = (1 - np.cos(angle)) / angle**2, (angle - np.sin(angle)) / angle**3
    return np.asarray(np.eye(3) - first * cross + second * cross @ cross, dtype=np.float64)


def modes_of(belief: Belief) -> list[Gaussian]:
    """The modes one by one."""
    alone = [belief.poses[np.array([k])] for k in range(len(belief))]
    return [Gaussian(*mode) for mode in zip(alone, belief.rates, belief.covariance, strict=True)]


def _gap(origin: Gaussian, other: Gaussian, domain: Domain) -> Array:
    found: Array = tangent(origin.pose, other.pose, domain.wrapping)[0]
    return found


def alike(mode: Gaussian, space: Space) -> Iterator[Gaussian]:
    """The mode and its twins: a search may have come upon another of them."""
    yield mode
    d = len(mode.rate)
    steps = _STEP * np.eye(d)
    around = retract(mode.pose, np.concatenate([steps, -steps]))
    for symmetry in space.twins:
        pose = space.domain.wrap(twin(mode.pose, symmetry))
        moved = tangent(pose, twin(around, symmetry), space.domain.wrapping)
        slope = np.zeros((2 * d, 2 * d))
        slope[:d, :d] = (moved[:d] - moved[d:]).T / (2 * _STEP)
        slope[d:, d:] = twin_rates(np.eye(d), symmetry).T
        yield Gaussian(pose, twin_rates(mode.rate[None], symmetry)[0], slope @ mode.covariance @ slope.T)


def _log_unknown(rate: Array, space: Space) -> float:
    """Log density of a pose and its rates where nothing is known of them: uniform, and the rates' own prior."""
    variance = space.motion.variance + _FLOOR
    normal = -0.5 * (np.sum(rate**2 / variance) + np.sum(np.log(2 * np.pi * variance)))
    return float(normal) - space.domain.log_volume


def _collect(
    belief: Belief, shares: Array, merged: Sequence[Sequence[tuple[float, Array, Array]]], domain: Domain
) -> Belief:
    """Each mode's mixture over what came after, as one Gaussian; modes that nothing led to are left out."""
    d = belief.n_tangent
    kept = [int(i) for i in np.argsort(-shares)[:MOST_MODES] if shares[i] >= LEAST_MODE]
    poses, rates, covariances = [], [], []
    for i in kept:
        weights = np.array([share for share, _, _ in merged[i]]) / shares[i]
        shifts = np.array([shift for _, shift, _ in merged[i]])
        shift = weights @ shifts
        rest = shifts - shift
        covariance = np.einsum("n,nij->ij", weights, np.array([c for _, _, c in merged[i]]))
        covariance += second_moment(weights, rest)
        poses.append(_inside(retract(belief.poses[np.array([i])], shift[None, :d]), domain))
        rates.append(belief.rates[i] + shift[d:])
        covariances.append(0.5 * (covariance + covariance.T))
    return replace(
        belief,
        log_weights=np.log(shares[kept] / shares[kept].sum()),
        poses=concatenate(*poses),
        rates=np.array(rates),
        covariance=np.array(covariances),
    )


def _inside(pose: Poses, domain: Domain) -> Poses:
    """The pose with its joints within their ranges."""
    wrapped = domain.wrap(pose)
    least, greatest = domain.joint_bounds
    return replace(wrapped, joints=np.clip(wrapped.joints, least, greatest))

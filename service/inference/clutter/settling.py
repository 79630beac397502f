"""The posterior about poses by population Monte Carlo (Cappe, Guillin, Marin, Robert 2004): draws of a Gaussian are
weighed, and the next draws are of their mean and covariance.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from service.inference.clutter.outlook import Outlook
from service.inference.estimate import tangent
from service.inference.numerics.gauss_newton import within
from service.inference.numerics.student import root_of
from service.inference.pose import pick, repeat, retract
from service.inference.state import Array, Poses

_EFFECTIVE = 0.2  # numerical: of the draws that share the weight, at the least
_CUT, _CUTS = 0.6, 24  # numerical: of the power that leaves so many
_MIXED = 0.1  # numerical: of the spread before, against draws that all lie in fewer directions than there are


@dataclass(frozen=True)
class Expected:
    """What is believed of each of K poses beside the outline: Gaussian about these."""

    poses: Poses  # (K)
    precision: Array  # (K, d, d)
    wrapping: NDArray[np.bool_]  # (J,) joints that turn all the way round

    def log_prior(self, poses: Poses, count: int) -> Array:
        """(K * count,) of poses that are K in turn, ``count`` of each; not normalised."""
        off = tangent(repeat(self.poses, count), poses, self.wrapping)
        return np.asarray(-0.5 * np.einsum("ni,nij,nj->n", off, np.repeat(self.precision, count, axis=0), off))


@dataclass(frozen=True)
class Settled:
    """K poses at their best, the spread about them, and what they are worth there."""

    poses: Poses
    covariance: Array  # (K, d, d)
    nats: Array  # (K,) log posterior

    def __getitem__(self, which: NDArray[np.intp]) -> Settled:
        return Settled(self.poses[which], self.covariance[which], self.nats[which])


def settle(
    rng: np.random.Generator,
    outlook: Outlook,
    poses: Poses,
    covariance: Array,
    *,
    rounds: int,
    draws: int,
    expected: Expected | None = None,
) -> Settled:
    """K poses climb by ``rounds`` of ``draws`` each; ``covariance`` (K, d, d) of the first ones."""
    k, d = len(poses), covariance.shape[1]

    def target(some: Poses, count: int) -> Array:
        nats = outlook.score(some)
        return np.asarray(nats if expected is None else nats + expected.log_prior(some, count)).reshape(k, count)

    best, top, middle = poses, target(poses, 1)[:, 0], poses
    for _ in range(rounds):
        half = rng.standard_normal((k, draws // 2, d))
        unit = np.concatenate([half, -half], axis=1)
        count = unit.shape[1]
        steps = unit @ np.stack([root_of(one) for one in covariance]).transpose(0, 2, 1)
        tried = _held(outlook, retract(repeat(middle, count), steps.reshape(-1, d)))
        nats = target(tried, count)
        weights = _weights(nats, 0.5 * (unit**2).sum(axis=2))
        mean = np.einsum("kn,kni->ki", weights, steps)
        off = steps - mean[:, None]
        covariance = (1 - _MIXED) * np.einsum("kn,kni,knj->kij", weights, off, off) + _MIXED * covariance
        middle = _held(outlook, retract(middle, mean))
        lead = np.arange(k) * count + nats.argmax(axis=1)
        for new, worth in ((tried[lead], nats.max(axis=1)), (middle, target(middle, 1)[:, 0])):
            best, top = pick(worth > top, new, best), np.maximum(worth, top)
    return Settled(best, covariance, top)


def _held(outlook: Outlook, poses: Poses) -> Poses:
    """With joints within their ranges."""
    return replace(poses, joints=within(outlook.drawing, poses.joints))


def _weights(nats: Array, surplus: Array) -> Array:
    """(K, n) of the draws: on the way from the law that they are of to the target as far as enough share the weight.

    ``surplus`` (K, n): what that law is short of its peak.
    """
    gain = nats + surplus
    power = np.ones((len(nats), 1))
    for _ in range(_CUTS):
        weights = np.exp(power * (gain - gain.max(axis=1, keepdims=True)))
        weights /= weights.sum(axis=1, keepdims=True)
        few = (weights**2).sum(axis=1, keepdims=True) * _EFFECTIVE * nats.shape[1] > 1
        if not few.any():
            break
        power = np.where(few, _CUT * power, power)
    return np.asarray(weights, np.float64)

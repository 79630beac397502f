"""What is known of a pass's motion (docs/motion.md), and what follows from it. Needs no SciPy."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from service.inference.pose import angle_between, multiply, rotation_matrices
from service.inference.spin.rigid_body import Motions, inertia, moved, orientations, places
from service.inference.state import Array

Model = Literal["constant_rate", "tumbling"]
Bodies = Literal["free", "mesh"]
MODES = ("inertially_fixed", "nadir_pointing", "yaw_steering", "sun_pointing", "spin_stabilised", "tumbling")
"""Attitude modes: what holds a body, or that nothing does."""
JOINT_LAWS = ("still", "sun_tracking", "neither")
"""What a hinge does over a pass."""
_SAME_RAD = 0.1  # numerical: two basins whose orientations are nowhere further apart are one course
_DIFFERENCE = 1e-5  # numerical: of a difference quotient


@dataclass(frozen=True)
class Basin:
    """One motion that may be true. P = 6 (turn in fixed axes, rate) or 11 (and shape)."""

    model: Model
    bodies: Bodies  # which prior of the inertia
    motion: Motions  # one, at the pass's reference time
    covariance: Array  # (P, P) of the steps of ``moved``
    log_evidence: float  # but for what the frames say of one mode against another
    log_weights: float  # the sum of that over the frames
    explained: float  # share of the frames
    scale: float  # by which the frames' stated spreads are to be multiplied
    independent: float  # frames, were each to err by itself


@dataclass(frozen=True)
class AttitudeModes:
    """Probabilities of ``MODES``, all as likely before; of each that holds a frame its best motion, told in that."""

    probabilities: Mapping[str, float]
    held: Mapping[str, Basin]

    @property
    def best(self) -> str:
        """The most probable one."""
        return max(self.probabilities, key=lambda name: self.probabilities[name])


@dataclass(frozen=True)
class JointLaw:
    """Probabilities of ``JOINT_LAWS``, all as likely before, and the constant of the two that have one."""

    name: str
    probabilities: Mapping[str, float]
    constants: Mapping[str, tuple[float, float]]  # value, or what the panel is ahead of the Sun; and its sigma: degrees

    @property
    def best(self) -> str:
        """The most probable one."""
        return max(self.probabilities, key=lambda law: self.probabilities[law])


@dataclass(frozen=True)
class PassMotion:
    """Basins, most probable first, with their probabilities."""

    reference_s: float
    half_span_s: float  # from the reference time to the first and to the last frame
    basins: tuple[Basin, ...]
    probabilities: Array  # (K,)
    n_frames: int  # used
    rotations: tuple[Array, ...] = ()  # (4,) each: q s is seen as q is
    attitude: AttitudeModes | None = None  # where orbit, Sun and camera are known
    joints: tuple[JointLaw, ...] = ()  # there, too

    def probability_of(self, model: Model) -> float:
        """Of a hypothesis."""
        return float(sum(p for p, b in zip(self.probabilities, self.basins, strict=True) if b.model == model))

    @property
    def model(self) -> Model:
        """The more probable hypothesis."""
        return "tumbling" if self.probability_of("tumbling") > 0.5 else "constant_rate"

    def best_of(self, model: Model) -> Basin:
        """The most probable basin of a hypothesis; of the other where this one has none."""
        return next((basin for basin in self.basins if basin.model == model), self.basins[0])

    def same(self, one: Basin, other: Basin) -> bool:
        """Whether two basins are of the same orientations, or of such as look the same."""
        return same_course(one.motion, other.motion, self.half_span_s, self.rotations)

    def courses(self) -> list[tuple[float, Basin]]:
        """Courses of orientations that differ, with their probabilities, most probable first, and a basin of each."""
        found: list[tuple[float, Basin]] = []
        for p, basin in zip(self.probabilities, self.basins, strict=True):
            for k, (sum_so_far, other) in enumerate(found):
                if self.same(basin, other):
                    found[k] = (sum_so_far + float(p), other)
                    break
            else:
                found.append((float(p), basin))
        return sorted(found, key=lambda one: -one[0])


def same_course(one: Motions, other: Motions, half_span_s: float, rotations: Sequence[Array] = ()) -> bool:
    """Whether two motions show the same orientations throughout, the one as it is or through one of ``rotations``."""
    at = places(-half_span_s, half_span_s)
    first, second = orientations(one, at), orientations(other, at)
    seen = [first, *(multiply(first, s) for s in rotations)]
    return any(float(np.max(angle_between(image, second))) < _SAME_RAD for image in seen)


@dataclass(frozen=True)
class Told:
    """A quantity (m,) with its covariance (m, m)."""

    value: Array
    covariance: Array

    @property
    def sigma(self) -> Array:
        """(m,)"""
        return np.asarray(np.sqrt(np.maximum(np.diag(self.covariance), 0.0)))


def told(basin: Basin, quantity: Callable[[Motions], Array]) -> Told:
    """A quantity of a motion (m,), its covariance to first order."""
    motion, count = basin.motion, basin.motion.n_parameters
    step = _DIFFERENCE * np.sqrt(np.maximum(np.diag(basin.covariance), 1e-12)) * np.eye(count)
    size = np.diag(step)
    slopes = [
        (quantity(moved(motion, step[k : k + 1])) - quantity(moved(motion, -step[k : k + 1]))) / (2 * size[k])
        for k in range(count)
    ]
    jacobian = np.stack(slopes, axis=1)
    return Told(quantity(motion), jacobian @ basin.covariance @ jacobian.T)


def rate_body(motion: Motions) -> Array:
    """(3,) rad/s in body axes at the reference time."""
    return np.asarray(motion.rate[0])


def rate_fixed(motion: Motions) -> Array:
    """(3,) rad/s in fixed axes at the reference time."""
    return np.asarray(rotation_matrices(motion.quaternion[0]) @ motion.rate[0])


def axis_body(motion: Motions) -> Array:
    """(3,) unit vector along the rate, in body axes at the reference time."""
    return _unit(motion.rate[0])


def axis_fixed(motion: Motions) -> Array:
    """(3,) unit vector in fixed axes that the motion keeps: along the rate, of a free body the angular momentum."""
    return _unit(rotation_matrices(motion.quaternion[0]) @ _momentum(motion))


def turning_rate(motion: Motions) -> Array:
    """(1,) rad/s about that axis, which stays: w, of a free body 2 T / L (Samarasinha, A'Hearn 1991)."""
    momentum = _momentum(motion)
    return np.array([motion.rate[0] @ _unit(momentum)])


def inertia_ratios(motion: Motions) -> Array:
    """(2,) the least and the middle moment of inertia over the greatest."""
    values = np.linalg.eigvalsh(inertia(motion.shape[0]))
    return np.asarray(values[:2] / values[2])


def nutation(motion: Motions) -> Array:
    """(1,) rad: angle between the rate and the angular momentum at the reference time."""
    cosine = float(np.clip(_unit(motion.rate[0]) @ _unit(_momentum(motion)), -1.0, 1.0))
    return np.array([np.arccos(cosine)])


def _momentum(motion: Motions) -> Array:
    if not motion.shape.shape[1]:
        return np.asarray(motion.rate[0])
    return np.asarray(inertia(motion.shape[0]) @ motion.rate[0])


def _unit(vector: Array) -> Array:
    return np.asarray(vector / max(float(np.linalg.norm(vector)), 1e-15))

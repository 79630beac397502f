"""What goes into a step on the device and what comes out of it, as plain arrays."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pyopencl as cl
from numpy.typing import NDArray

from gpu.errors import ScorerError

Floats = NDArray[np.float64]

STAGE = np.dtype(
    [("axis", "f4", 3), ("origin", "f4", 3), ("held", "f4"), ("slides", "i4"), ("joint", "i4")]
)  # as in kernels/step_motion.cl


@dataclass(frozen=True)
class Stage:
    """One motion of some parts about (or along, where it ``slides``) an axis in the body frame at rest."""

    axis: tuple[float, float, float]  # unit
    origin: tuple[float, float, float]  # model units
    slides: bool
    parts: tuple[int, ...]  # numbers of the parts that it moves
    joint: int | None  # number of the joint that drives it; None: it stays at ``held``
    held: float = 0.0  # degrees, or model units where it slides


@dataclass(frozen=True)
class Body:
    """Parts and what moves them; ``stages`` in the order in which they are applied, deepest first."""

    n_parts: int
    n_joints: int = 0
    stages: tuple[Stage, ...] = ()

    def stage_arrays(self) -> tuple[NDArray[np.void], NDArray[np.int32]]:
        """(S,) stages as the kernel reads them, and (S, P) flags of the parts that each moves."""
        table = np.zeros(len(self.stages), STAGE)
        moves = np.zeros((len(self.stages), self.n_parts), np.int32)
        for s, stage in enumerate(self.stages):
            joint = -1 if stage.joint is None else stage.joint
            table[s] = (stage.axis, stage.origin, stage.held, stage.slides, joint)
            moves[s, list(stage.parts)] = 1
        return table, moves


@dataclass(frozen=True)
class Bounds:
    """The uniform prior's bounds of x, y (px), log scale and the joints. ``period`` is 0 where a value has none."""

    low: Floats  # (3 + J,)
    high: Floats  # (3 + J,)
    period: Floats  # (3 + J,) 360 for joints that turn all the way round: they are wrapped, not bounded


@dataclass(frozen=True)
class Particles:
    """N weighted particles in host memory."""

    quaternion: Floats  # (N, 4) w, x, y, z; body -> camera
    position: Floats  # (N, 2) px
    log_scale: Floats  # (N,) log of px per model unit
    joints: Floats  # (N, J) degrees or model units
    log_weights: Floats  # (N,) log of weights that sum to 1

    def __len__(self) -> int:
        return len(self.log_scale)


@dataclass(frozen=True)
class DeviceParticles:
    """N weighted particles in the device's memory: 4 (9 + J) bytes each.

    ``log_weights`` is relative to the heaviest particle; ``log_total`` is the log of the sum of those weights.
    """

    n: int
    rotations: cl.Buffer  # (N, 4) float32 x, y, z, w
    values: cl.Buffer  # (3 + J, N) float32 x, y, log scale, joints
    log_weights: cl.Buffer  # (N,) float32
    log_total: float


@dataclass(frozen=True)
class Summary:
    """The posterior of a frame in numbers (Eq. 5). ``log_likelihood`` is the particle term of Eq. 4."""

    quaternion: Floats  # (4,) w, x, y, z: mean on SO(3)
    position: Floats  # (2,) px
    scale: float  # px per model unit
    joints: Floats  # (J,) on their circle where they turn all the way round
    covariance: Floats  # (6 + J, 6 + J) about the mean: rotation vector (rad, body side), x, y, log scale, joints
    scale_deviation: float  # px per model unit
    ess: float  # effective sample size
    log_evidence: float  # log of the mean likelihood (to its exponent)
    best: int  # the particle of highest likelihood
    best_log_likelihood: float


def device_layout(particles: Particles) -> tuple[Sequence[NDArray[np.float32]], float]:
    """Rotations, values and log weights as ``DeviceParticles`` holds them, and the log of the weights' sum.

    Raises ``ScorerError`` where no weight is positive, or a pose is not finite.
    """
    heaviest = float(np.max(particles.log_weights, initial=-np.inf))
    relative = particles.log_weights - heaviest if np.isfinite(heaviest) else np.full(len(particles), np.nan)
    values = np.vstack([particles.position.T, particles.log_scale[None], particles.joints.T])
    if len(particles) == 0 or np.isnan(relative).any():
        raise ScorerError("no particle has a positive weight, or one has none at all")
    if not (np.isfinite(values).all() and np.isfinite(particles.quaternion).all()):
        raise ScorerError("a particle's pose is not finite")
    arrays = [np.roll(particles.quaternion, -1, axis=1), values, relative]
    return [np.ascontiguousarray(a, dtype=np.float32) for a in arrays], float(np.log(np.exp(relative).sum()))

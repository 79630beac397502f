"""What the parts of one frame's update share."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from service.inference.acquisition import Evidence
from service.inference.domain import Domain
from service.inference.modes import Metric, metric_of
from service.inference.motion import MotionNoise, motion_noise
from service.inference.params import SessionConfig
from service.inference.slope import Slope
from service.inference.state import Array, FilterState, Frame, Poses
from service.inference.symmetry import Symmetry

ScoreMaps = Callable[[Poses, NDArray[np.float32]], Array]


class Brightness(Protocol):
    """Log-likelihood of a frame's brightness near a pose, to second order."""

    @property
    def gradient(self) -> Array:
        """(d,) at the pose."""

    @property
    def curvature(self) -> Array:
        """(d, d) of its negative, positive semi-definite."""

    @property
    def pixels(self) -> float:
        """How many independent ones it is told by."""


class Shade(Protocol):
    """A frame's light and shade, held against bodies."""

    def __call__(self, poses: Poses) -> Array:
        """(N,) log of how many times less of the brightness each leaves over than no body does."""

    def near(self, pose: Poses) -> Brightness | None:
        """What the brightness says near one pose; None where it says nothing."""


MOST_SURPRISE = 3.0


@dataclass(frozen=True)
class Update:
    """One frame, the state before it, and how to go about it."""

    rng: np.random.Generator
    state: FilterState | None
    frame: Frame
    score_maps: ScoreMaps
    config: SessionConfig
    domain: Domain
    twins: Sequence[Symmetry]
    shade: Shade | None = None

    @cached_property
    def maps(self) -> NDArray[np.float32]:
        """(1, H, W): one array, so that the scorer knows it again."""
        return self.frame.measurement.log_ratio[None]

    @cached_property
    def light(self) -> float:
        """Sum of the map's positive part: what a silhouette could explain at most."""
        return float(np.sum(np.maximum(self.frame.measurement.log_ratio, 0.0)))

    @cached_property
    def metric(self) -> Metric:
        """How far apart two poses of one mode may be."""
        return metric_of(self.domain.articulation)

    @property
    def dt_s(self) -> float:
        """Time since the last frame."""
        return 1e-3 if self.state is None else max(self.frame.time_s - self.state.time_s, 1e-3)

    def score(self, poses: Poses) -> Array:
        """(N,) the particle term of Eq. 4; poses outside of the prior's bounds explain none of the light."""
        return np.where(self.domain.contains(poses), self.score_maps(poses, self.maps)[:, 0], -self.light - 1.0)

    def shading(self, poses: Poses) -> Array:
        """(N,) nats by which light and shade inside of the outline speak for each pose."""
        worth = self.config.likelihood.shading_nats
        return np.zeros(len(poses)) if self.shade is None or worth == 0 else worth * self.shade(poses)

    def slope(self, pose: Poses) -> Slope | None:
        """What light and shade say of the poses near one."""
        power = self.config.likelihood.shading_power
        near = None if self.shade is None or power == 0 else self.shade.near(pose)
        return None if near is None else Slope(pose, power * near.gradient, power * near.curvature, power * near.pixels)

    def recall(self, name: str, otherwise: Array | float) -> Array:
        """Something remembered from earlier frames."""
        if self.state is None or name not in self.state.memory:
            return np.asarray(otherwise, dtype=np.float64)
        return np.asarray(self.state.memory[name], dtype=np.float64)

    @cached_property
    def rates(self) -> MotionNoise:
        """How poses and rates change."""
        return motion_noise(self.config.motion, self.domain)

    def misfit(self, evidence: Evidence, poses: Poses, log_likelihood: Array) -> float:
        """What the best of the silhouettes leaves unexplained of the light and covers in vain: nats per pixel of the
        object's radius, since what a map gets wrong lies along the outline."""
        top = int(np.argmax(log_likelihood))
        radius_px = self.domain.radius * float(np.exp(poses.log_scale[top]))
        return max(0.0, evidence.light_nats - float(log_likelihood[top])) / radius_px

    def exponent(self, misfit: float | None = None) -> float:
        """Power of the likelihood near a peak, after ``misfit`` (by default that of the frames before).

        A quasi-likelihood (Wedderburn 1974): the dispersion is told by what the best fit leaves over. A map that even
        the best silhouette contradicts, in turbulence or half in shadow, knows less of the pose.
        """
        likelihood = self.config.likelihood
        left = float(self.recall("misfit", 0.0)) if misfit is None else misfit
        return likelihood.exponent / (1.0 + left / likelihood.misfit_nats)

    @property
    def surprise(self) -> float:
        """How much further than predicted the poses have been lately, 1 or more: the prediction widens with it."""
        return float(np.clip(np.sqrt(self.recall("surprise", 1.0)), 1.0, MOST_SURPRISE))

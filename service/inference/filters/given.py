"""What a step of ``filters.mixture`` is given, and what its verbs hand on to each other."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from service.inference.domain import Domain
from service.inference.held import Held
from service.inference.model.nuisance import Nuisance
from service.inference.model.stages import Body, Sight
from service.inference.model.templates import Bank
from service.inference.numerics.hill import Refined
from service.inference.numerics.priors import Believed, PosePrior
from service.inference.params import SessionConfig
from service.inference.state import Array, Displaced, Poses
from service.inference.symmetry import Symmetry


class LitFrame(Protocol):
    """A frame's light, and where it is."""

    @property
    def sight(self) -> Sight | None:
        """What is brightest and what lies near it; None: there is no light."""
        ...

    @property
    def wide(self) -> Sight | None:
        """The same with what lies further off, until almost all light is in it."""
        ...

    def around(self, centre: Array, reach_px: float, span_px: float, psf_px: float) -> Sight:
        """The light within ``reach_px`` of a place; where there is none, a square of ``span_px``."""
        ...


@dataclass(frozen=True)
class Given:
    """All that a frame's step is given beside the state."""

    frame: LitFrame
    body: Body
    bank: Callable[[], Bank]
    told: PosePrior
    config: SessionConfig
    domain: Domain
    twins: Sequence[Symmetry]
    index: int
    time_s: float
    held: Held | None = None  # the attitude mode that was told


@dataclass(frozen=True)
class Predicted:
    """Modes ahead of a frame."""

    poses: Poses
    rates: Array
    covariance: Array  # (K, 2d, 2d)
    suns: Array
    sun_sigmas: Array  # (K,)
    paint: Array  # (K, 2, P)
    log_weights: Array
    existence: Array  # (3,)
    displaced: Displaced | None
    returning: int | None = None  # number of the mode that a displaced answer had; the last
    aside: Array = field(default_factory=lambda: np.zeros(2))  # px from there to where the frame shows their light

    def believed(self, wrapping: NDArray[np.bool_], at: NDArray[np.intp] | slice = slice(None)) -> Believed:
        """What is known of the modes that are numbered ``at``, each of them of its own climb."""
        d = self.rates.shape[1]
        precision = np.asarray(np.linalg.inv(self.covariance[at][:, :d, :d]), np.float64)
        suns = self.suns[at], self.sun_sigmas[at] ** -2
        return Believed(self.poses[at], precision, wrapping, self.paint[at], *suns)


@dataclass(frozen=True)
class Updated:
    """Modes after a frame, not yet pruned; K of them followed, then those that were born."""

    refined: list[Refined]
    rates: Array
    covariance: Array
    paint: Array  # (K, 2, P)
    log_weights: Array  # (K,) not normalised: with the frame's evidence
    existence: Array  # (3,) as if the truth were among the modes
    nuisance: Nuisance
    log_chi2: Array  # (2,)
    log_light: float
    log_discrepancy: Array  # (2,)
    nats: float  # log evidence of this body against the empty sky
    hidden: float  # share of its light that lies where nothing is known
    n_followed: int  # K
    disturbed: float  # probability that something has come between, were the last answer right

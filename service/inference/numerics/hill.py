"""What poses climb on, and where a climb ends."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from service.inference.model.drawing import EVEN_PLANES, FINE, Drawing, Quality, View
from service.inference.model.likelihood import ROUNDS, Fit
from service.inference.model.paint import painted
from service.inference.model.scene import Images, Scene
from service.inference.model.terms import Terms, terms_of
from service.inference.numerics.priors import PosePrior
from service.inference.state import Array, Poses


@dataclass(frozen=True)
class Trust:
    """How far one step may go, as the standard deviations of a prior on it: linear no further."""

    turn: float = 0.1  # rad
    place: float = 0.1  # of the body's radius
    log_scale: float = 0.1
    joint: float = 0.15  # rad, or share of the range


@dataclass(frozen=True)
class Hill:
    """What poses climb on."""

    scene: Scene
    drawing: Drawing
    view: View
    told: PosePrior
    quality: Quality = FINE
    difference: float = 0.5  # patch px by which a difference moves the body's rim
    sun_free: bool = True
    rounds: int = ROUNDS
    trust: Trust = Trust()

    @cached_property
    def terms(self) -> Terms:
        """The hill's scene and priors, as the likelihood holds them."""
        return self._under(self.scene)

    def _under(self, scene: Scene) -> Terms:
        groups = self.drawing.n_groups
        return terms_of(scene, groups, groups * (1 + len(self.quality.gloss)) + EVEN_PLANES)

    def log_evidences(self, planes: Images) -> Array:
        """(N,) of drawn poses (N, Q, S, S)."""
        found = self.drawing.light.evidence(planes, self.drawing.n_groups, self.terms, self.rounds)
        return np.asarray(found.log_evidence, np.float64)

    def log_evidences_under(
        self, planes: Images, ways: Sequence[tuple[Scene, Array | None]], ended: Images | None = None
    ) -> Array:
        """(W, N) the same under several scenes of one patch and low pass at once, each with its paint or None.

        ``ended`` (N, U): unknowns of the same poses under another scene, to begin with.
        """
        count, groups, out = len(planes), self.drawing.n_groups, np.empty((len(ways), len(planes)))
        terms = [self.terms if scene is self.scene else self._under(scene) for scene, _ in ways]
        terms = [
            one if paint is None else painted(one, paint[None]) for one, (_, paint) in zip(terms, ways, strict=True)
        ]
        for shifts in {one.shifts for one in terms}:  # which are no unknowns in calm air
            at = [k for k, one in enumerate(terms) if one.shifts == shifts]
            each = [terms[k] for k in at for _ in range(count)]
            if ended is not None:
                each = [one.begun(ended[k % count][None]) for k, one in enumerate(each)]
            found = self.drawing.light.evidence(planes, groups, each, self.rounds, [*range(count)] * len(at))
            out[at] = found.log_evidence.reshape(len(at), count)
        return out


@dataclass(frozen=True)
class Refined:
    """A pose, the Sun it goes with, its light, and the covariance of (rx, ry, rz, x, y, log scale, joints)."""

    pose: Poses  # one
    sun: Array  # (3,)
    sun_sigma: float  # rad, each axis across it
    fit: Fit
    log_posterior: float  # evidence, and the prior of scale and Sun
    covariance: Array  # (6 + J, 6 + J) rad, frame px, log, deg or model units
    paint_variance: Array  # (Q - 4,) of log paint, the gain given: ``curvature.paint_variance``

"""What poses climb on, and where a climb ends."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from service.inference.model.drawing import FINE, Cut, Drawing, Quality, View
from service.inference.model.likelihood import ROUNDS, Fit
from service.inference.model.paint import painted
from service.inference.model.scene import Images, Scene
from service.inference.model.terms import Terms, terms_of
from service.inference.numerics.priors import PosePrior
from service.inference.state import Array, Poses

# numerical: times a climb's rounds, from the prior: a light that is still settling looks like a gain of every step
AFRESH = 3


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

    @property
    def bytes_drawn(self) -> int:
        """Of one pose's planes."""
        return 4 * self.drawing.n_planes(self.quality) * self.view.side**2

    def _under(self, scene: Scene) -> Terms:
        return terms_of(scene, self.drawing.n_groups, self.drawing.n_planes(self.quality), self.drawing.pieces)

    def log_evidences(self, planes: Images | Cut, terms: Terms | None = None) -> Array:
        """(N,) of drawn poses (N, Q, S, S); ``terms``: other than the hill's own."""
        found = self.drawing.light.evidence(planes, self.drawing.n_groups, terms or self.terms, self.rounds)
        return np.asarray(found.log_evidence, np.float64)

    def log_evidences_under(
        self,
        planes: Images | Cut,
        ways: Sequence[tuple[Scene, Array | None]],
        ended: Images | None = None,
        which: NDArray[np.intp] | None = None,
    ) -> Array:
        """(W, N) the same under several scenes of one patch and low pass at once, each with its paint or None.

        ``ended`` (N, U): unknowns of the same poses under another scene, to begin with. ``which`` (N,): numbers of the
        drawn poses; None: all.
        """
        which = np.arange(len(planes)) if which is None else which
        count, groups, out = len(which), self.drawing.n_groups, np.empty((len(ways), len(which)))
        terms = [self.terms if scene is self.scene else self._under(scene) for scene, _ in ways]
        terms = [
            one if paint is None else painted(one, paint[None]) for one, (_, paint) in zip(terms, ways, strict=True)
        ]
        for shifts in {one.shifts for one in terms}:  # which are no unknowns in calm air
            at = [k for k, one in enumerate(terms) if one.shifts == shifts]
            each = [terms[k] for k in at for _ in range(count)]
            if ended is not None:
                each = [one.begun(ended[k % count][None]) for k, one in enumerate(each)]
            found = self.drawing.light.evidence(planes, groups, each, self.rounds, [*which] * len(at))
            out[at] = found.log_evidence.reshape(len(at), count)
        return out


@dataclass(frozen=True)
class Looked:
    """N poses on a hill: as they are drawn there, and their light at its best."""

    hill: Hill
    planes: Cut  # (M, Q, S, S)
    which: NDArray[np.intp]  # (N,) numbers of theirs
    values: Images  # (N, U) unknowns of their light
    log_evidence: Array  # (N,)

    def __getitem__(self, index: NDArray[np.intp] | slice) -> Looked:
        return replace(self, which=self.which[index], values=self.values[index], log_evidence=self.log_evidence[index])

    def is_drawn_on(self, hill: Hill) -> bool:
        """Whether a hill differs in its scene alone."""
        other = self.hill
        return hill.drawing is other.drawing and (hill.view, hill.quality) == (other.view, other.quality)

    def on(self, hill: Hill) -> Looked:
        """The same on such a hill."""
        return _settled(hill, self.planes, self.which, self.values)

    def log_evidences(self, scenes: Sequence[Scene]) -> Array:
        """(W, N) under each of some scenes of the hill's patch."""
        return self.hill.log_evidences_under(self.planes, [(one, None) for one in scenes], self.values, self.which)


def looked(hill: Hill, poses: Poses, suns: Array) -> Looked:
    """N poses on a hill, each with its Sun (N, 3)."""
    planes = hill.drawing.cut(poses, suns, hill.view, hill.quality)
    return _settled(hill, planes, np.arange(len(poses)), None)


def _settled(hill: Hill, planes: Cut, which: NDArray[np.intp], ended: Images | None) -> Looked:
    terms, rounds = (hill.terms, AFRESH * hill.rounds) if ended is None else (hill.terms.begun(ended), hill.rounds)
    found = hill.drawing.light.evidence(planes, hill.drawing.n_groups, terms, rounds, [*which])
    return Looked(hill, planes, which, found.values, np.asarray(found.log_evidence, np.float64))


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

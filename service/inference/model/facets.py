"""Facets of one piece are painted alike (docs/model.md, sections 1 and 3): the law of log albedos.

Of facet f of a piece, log albedo is a + d_f: a is the piece's, d_f its own. Gloss is that of pieces. Where the Sun
shines on a surface that is no matt one, and where faces light each other, facets of one paint differ. The readable twin
of ``gpu/kernels/evidence_facets.cl``.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from service.inference.model import prior
from service.inference.state import Array

Numbers = NDArray[np.floating[Any]]

_ROUNDS = 12  # numerical: of Newton's method, from below on a convex function


@dataclass(frozen=True)
class Facets:
    """Which of P planes are facets of one piece, and how alike they are. ``gpu.evidence_terms.Facets``."""

    piece: NDArray[np.int32]  # (P,) numbers of pieces, in rising order
    own: NDArray[np.float32]  # (P,) precision of d; 0: a plane is alone
    common: NDArray[np.float32]  # (P,) precision of a

    @cached_property
    def any(self) -> bool:
        """Whether any plane has others of its piece."""
        return bool(self.own.any())

    @cached_property
    def _starts(self) -> NDArray[np.intp]:
        return np.flatnonzero(np.diff(self.piece, prepend=-1))

    def _sum(self, values: Array) -> Array:
        """(..., P) of each plane the sum over its piece."""
        sums = np.add.reduceat(values, self._starts, axis=-1)
        return np.asarray(np.repeat(sums, np.diff(self._starts, append=len(self.piece)), axis=-1))

    def expected(self, mean: Numbers, precision: Numbers) -> tuple[Array, Array]:
        """(..., P) means and variances, from those about what each piece has in common: ``own`` and what was learnt."""
        means, known = np.asarray(mean, np.float64), np.asarray(precision, np.float64)
        if not self.any:
            return means, 1 / known
        common, variance = self._common(means, known)
        share = self.own / known
        return means + share * common, 1 / known + share**2 * variance

    def covariance(self, precision: Numbers) -> Array:
        """(P, P) of all planes."""
        precision = np.asarray(precision, np.float64)
        share = self.own / precision
        together = np.outer(share, share) * (self.piece[:, None] == self.piece)
        _, variance = self._common(np.zeros(len(share)), precision)
        return np.asarray(np.diag(1 / precision) + together * variance)

    def _common(self, mean: Array, precision: Numbers) -> tuple[Array, Array]:
        """(..., P) mean and variance of a: each facet tells it as well as it is known, and no better than to d."""
        sure = self._sum(self.own - self.own**2 / precision) + self.common
        sure = np.where(self.own > 0, sure, 1.0)
        return np.where(self.own > 0, self._sum(self.own * mean), 0.0) / sure, 1 / sure

    def told_alone(
        self, before: Array, lit: NDArray[np.intp], value: Array, variance: Array, alone: Array
    ) -> tuple[Array, Array]:
        """(P,) pull and information that frames have of each plane itself, so that ``value`` (P,) and ``variance`` (P,)
        are what follows with what is known of the others.

        ``before`` (2, P): as they were told before; it stays where nothing is ``lit``. ``alone`` (P,): precision of the
        prior where a plane is alone. Variances of a piece go with the precision K of what it has in common, which goes
        with their information: one equation in K.
        """
        shows = np.zeros(len(value), dtype=bool)
        shows[lit] = True
        most = np.where(shows, 1 / np.where(shows, variance, 1.0), 0.0)
        information, pull = np.where(shows, np.maximum(most - alone, before[1]), before[1]), most * value
        if not self.any:
            return pull, information
        tied = shows & (self.own > 0)
        own, seen = np.where(self.own > 0, self.own, 1.0).astype(np.float64), np.where(tied, variance, 1.0)
        dark = np.where((self.own > 0) & ~shows, own * before[1] / (own + before[1]), 0.0)
        base = self.common + self._sum(dark)
        sure, least = np.where(base > 0, base, 1.0), 1 / (own + before[1])
        for _ in range(_ROUNDS):
            root = np.sqrt(1 + 4 * own**2 * seen / sure)
            narrow = sure * (root - 1) / (2 * own**2)  # variance of a facet, what is common known
            slope = (root - 1) / (2 * own**2) - seen / (sure * root)
            slope = np.where(tied & (narrow < least), own**2 * slope, 0.0)
            narrow = np.minimum(narrow, least)
            off = base + self._sum(np.where(tied, own - own**2 * narrow, 0.0)) - sure
            sure = np.where(base > 0, np.maximum(sure + off / (1 + self._sum(slope)), base), 1.0)
        information = np.where(tied, 1 / narrow - own, information)
        told = self._sum(dark * before[0] + np.where(tied, own * value, 0.0))
        common = told / np.where(base > 0, base + self._sum(np.where(tied, own, 0.0)), 1.0)
        return np.where(tied, value / narrow - own * common, pull), information


def facets_of(pieces: NDArray[np.int32] | None, counts: tuple[int, int]) -> Facets:
    """Of so many planes of albedo and of gloss; ``pieces``: of each surface group its piece's number, None: its own."""
    planes = sum(counts)
    if pieces is None:
        return Facets(np.arange(planes, dtype=np.int32), *np.zeros((2, planes), np.float32))
    piece = np.concatenate([pieces, int(pieces.max()) + 1 + np.arange(counts[1])]).astype(np.int32)
    several = np.bincount(piece)[piece] > 1
    own = np.where(several, prior.FACET_SIGMA**-2, 0.0).astype(np.float32)
    common = np.where(several, 1 / (prior.ALBEDO_SIGMA**2 - prior.FACET_SIGMA**2), 0.0).astype(np.float32)
    return Facets(piece, own, common)

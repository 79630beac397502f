"""What a mode has learnt of its body's paint (docs/model.md, section 5): log albedo and gloss of the surface groups.

Over their shares of the gain, which stays free in every frame: air and eye change it, not the paint. An array (2, P)
holds for P planes what frames have said beside the prior: its mean, and its information (one over a variance).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from service.inference.model import prior
from service.inference.model.drawing import EVEN_PLANES
from service.inference.model.likelihood import Fit
from service.inference.model.terms import Terms
from service.inference.state import Array


def unlearnt(n_planes: int) -> Array:
    """(2, P) of a body of which nothing is known, its drawings of Q = P + 4 planes."""
    return np.zeros((2, n_planes - EVEN_PLANES))


def expected(paint: Array, turned: Array | float = 0.0) -> Array:
    """(..., 2, P) ahead of a frame: turning surfaces are no matt ones, so what was learnt wears off.

    ``turned`` (...,): rad by which the body turns meanwhile. No more gets unknown than is of a body's other groups.
    """
    turn = np.asarray(turned, np.float64)[..., None]
    variance = prior.PAINT_DRIFT**2 + np.minimum(prior.PAINT_TURN * turn**2, prior.ALBEDO_SIGMA) ** 2
    out = paint.copy()
    out[..., 1, :] = paint[..., 1, :] / (1 + paint[..., 1, :] * variance)
    return out


def painted(terms: Terms, paint: Array) -> Terms:
    """The terms of N poses, each with its own (N, 2, P) beside the prior."""
    n, _, p = paint.shape
    mean, precision = (np.tile(one, (n, 1)) for one in (terms.mean, terms.precision))
    precision[:, :p] += paint[:, 1]
    mean[:, :p] = paint[:, 0] * paint[:, 1] / precision[:, :p]  # the prior's own mean is zero
    return replace(terms, mean=mean.astype(np.float32), precision=precision.astype(np.float32))


def learnt(fit: Fit, terms: Terms, before: Array, variance: Array, fits: float = 1.0) -> Array:
    """(2, P) after a frame that ``fit`` explains, from what was expected: its evidence, and part of the older.

    ``terms``: the priors, without ``before``. ``variance`` (P,): of log paint after the frame
    (``curvature.paint_variance``).

    Given the gain, so that what all planes share does not blur what tells them apart. Where it is more likely that
    this is not the body's light (``fits`` below a half) nothing is learnt, and what was known is slowly doubted.
    """
    out, lit, p = before.copy(), fit.lit, len(terms.offset)
    if fits < 0.5 and before[1].any():
        out[1] *= prior.PAINT_DOUBTED
        return out
    value = fit.values[:p].astype(np.float64)
    pull, total = terms.facets.told_alone(before, lit, value, variance, terms.precision[:p].astype(np.float64))
    out[0, lit] = np.where(total > 0, pull / np.maximum(total, 1e-12), 0.0)[lit]
    out[1, lit] = total[lit] - (1 - prior.MEMORY_KEPT) * before[1, lit]
    return out

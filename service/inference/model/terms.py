"""What the likelihood is told of a patch: a scene, and the priors of the light's unknowns as arrays."""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import log

import numpy as np
from numpy.typing import NDArray

from service.inference.model import prior
from service.inference.model.drawing import EVEN_PLANES
from service.inference.model.facets import Facets, facets_of
from service.inference.model.scene import Images, Scene, shift_bumps, sky_slopes
from service.inference.state import Array


@dataclass(frozen=True)
class Terms:
    """A scene and the priors of its unknowns as arrays, in the order in which the likelihood holds them.

    Unknowns: log of each positive plane's brightness over its prior share of the gain (albedo of a group, gloss of a
    group), log gain, even light, hidden sky, level and slopes of the sky, tilt of the even light (3), 12 of the point
    spread, 18 shifts.
    """

    scene: Scene
    offset: Images  # (Q - 4,)
    facets: Facets  # of the positive planes
    mean: Images  # (U,), or (N, U): of each pose its own
    precision: Images  # of facets: about what their piece has in common
    data: Images
    full: NDArray[np.bool_]
    stars: NDArray[np.uint8]
    slopes: Images
    behind: Images  # (S, S) light of the sky that can be hidden at a place, over its level
    bumps: Images
    gaussians: tuple[tuple[float, float], ...]
    noise: float
    photon: float
    hidden: float
    area: float
    wrong: float
    edge: float
    width: float
    gain: float
    star: float
    speckle: bool
    shifts: bool
    start: Images | None = None  # (N, U) where the unknowns of N poses begin; None: at ``mean``, the gain as fits best

    def begun(self, values: Images) -> Terms:
        """The same, to begin where unknowns (N, U') of other terms ended; shifts they lack begin at zero."""
        start = np.zeros((len(values), self.mean.shape[-1]), np.float32)
        count = min(start.shape[1], values.shape[1])
        start[:, :count] = values[:, :count]
        return replace(self, start=start)


def positive_priors(
    n_groups: int, n_planes: int, pieces: NDArray[np.int32] | None = None
) -> tuple[Images, Array, Facets]:
    """(Q - 4,) log of each positive plane's share of the gain; precision of its log about it, of facets about what
    their piece has in common; and what is that.
    """
    counts = n_groups, n_planes - EVEN_PLANES - n_groups
    offset = np.repeat(np.array([0.0, log(prior.GLOSS_SHARE)], np.float32), counts)
    alone, facets = np.repeat([prior.ALBEDO_SIGMA**-2, prior.GLOSS_LOG_SIGMA**-2], counts), facets_of(pieces, counts)
    return offset, np.where(facets.own > 0, facets.own, alone), facets


def terms_of(scene: Scene, n_groups: int, n_planes: int, pieces: NDArray[np.int32] | None = None) -> Terms:
    """The terms of a body of G groups whose drawings have Q planes; ``pieces`` (G,): of which each is a facet."""
    offset, positive, facets = positive_priors(n_groups, n_planes, pieces)
    wings = scene.point_spread.wings
    hides = prior.HIDDEN_MEAN, prior.HIDDEN_SIGMA
    if scene.hides is not None:
        hides = scene.share_of_sky(scene.hides), prior.HIDDEN_ALIKE
    sigmas = [prior.GAIN_SIGMA, scene.light.even_sigma, hides[1]] + [prior.SKY_SIGMAS * scene.sigma] * 3
    sigmas += [prior.EVEN_TILT_SIGMA] * 3
    means = [0.0] * len(positive) + [scene.gain, scene.light.even_mean, hides[0]]
    speckle, shifts = scene.shifts, scene.shifts and wings > 0
    if speckle:
        sigmas += [prior.HERMITE_SIGMA] * 12
    if shifts:
        sigmas += [prior.SHIFT_SHARE * wings] * 18
    return Terms(
        scene=scene,
        offset=offset,
        facets=facets,
        mean=np.array(means + [0.0] * (len(positive) + len(sigmas) - len(means)), np.float32),
        precision=np.concatenate([positive, 1.0 / np.array(sigmas) ** 2]).astype(np.float32),
        data=scene.data,
        full=scene.censored,
        stars=scene.stars,
        slopes=sky_slopes(scene.side),
        behind=scene.behind,
        bumps=shift_bumps(scene.side),
        gaussians=scene.point_spread.gaussians(scene.smoothing),
        noise=scene.sigma**2,
        photon=scene.photon,
        hidden=scene.hidden,
        area=scene.area,
        wrong=scene.alike * scene.discrepancy**2,
        edge=scene.grain * prior.EDGE_PX,
        width=scene.point_spread.width,
        gain=scene.gain,
        star=prior.STAR,
        speckle=speckle,
        shifts=shifts,
    )

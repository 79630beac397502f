"""The linear systems of Gauss-Newton: slopes of the models' images, and what they say of a pose (docs/model.md, 3)."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from service.inference.model.derivatives import across, derivatives
from service.inference.model.drawing import EVEN_PLANES
from service.inference.model.likelihood import Fit
from service.inference.model.prior import CHI2_DEGREES_OF_FREEDOM, POSE_DEGREES_OF_FREEDOM
from service.inference.model.scene import Images
from service.inference.numerics.hill import Hill
from service.inference.numerics.priors import Believed
from service.inference.state import Array, Poses


def slopes_of(hill: Hill, poses: Poses, suns: Array, fits: list[Fit]) -> NDArray[np.float32]:
    """(N, D, S, S) derivatives of the models' images."""
    blur = hill.scene.point_spread, hill.scene.smoothing
    shares = np.stack([fit.coefficients for fit in fits])
    given = hill.drawing, hill.view, hill.quality, blur, poses, suns, shares
    return derivatives(*given, difference=hill.difference, sun_free=hill.sun_free)


def systems_of(
    hill: Hill,
    poses: Poses,
    suns: Array,
    fits: list[Fit],
    slopes: Images,
    believed: Believed | None = None,
    at: NDArray[np.intp] | None = None,
) -> tuple[Array, Array, Array]:
    """Curvature (N, D, D) and slope (N, D) of each log posterior, the linear unknowns eliminated; and the curvature of
    which a spread is stated: with the discrepancy's scale as it is seen, and as if paint and Sun were unknown, since
    they were learnt from poses that erred as this one does.

    ``slopes`` (N, D, S, S). D: rotation (rad), place (frame px), log scale, joints, and the Sun (rad, two axes across
    it) where it is free.
    """
    known = None if believed is None or at is None else believed.paint[at, 1]
    if hill.drawing.slopes is None:
        normal, taken, unpainted, pull = eliminated(fits, slopes, known)
    else:
        normal, taken, unpainted, pull = hill.drawing.slopes.systems(slopes, [fit.row for fit in fits], known)
    sure, push = _prior(hill, poses, suns)
    stated = sure
    if believed is not None and at is not None:
        _add_believed_poses(believed, at, poses, sure, push)
        if hill.sun_free and hill.told.towards_sun is None:
            stated = sure.copy()
            _add_believed_suns(believed, at, suns, sure, push)
    seen = np.array([scale_seen(fit.chi2) for fit in fits])
    return normal + sure - taken, pull + push, (normal - unpainted) / seen[:, None, None] + stated


def eliminated(fits: list[Fit], slopes: Images, known: Array | None) -> tuple[Array, Array, Array, Array]:
    """The twin of ``gpu.slopes.LightSlopes.systems``, which says what it gives; ``known`` (N, Q - 4) of paint."""
    paint = [None] * len(fits) if known is None else known
    found = [_eliminated(*one) for one in zip(fits, slopes, paint, strict=True)]
    normal, taken, unpainted, pull = (np.stack(parts) for parts in zip(*found, strict=True))
    return normal, taken, unpainted, pull


def _eliminated(fit: Fit, slopes: Images, known: Array | None) -> tuple[Array, Array, Array, Array]:
    flat, weighted = _weighted(fit, slopes)
    pull = (weighted @ fit.residual[fit.window].ravel()).astype(np.float64)
    cross, d = _cross(fit, weighted), len(slopes)
    inner = np.linalg.solve(fit.normal, np.column_stack([cross, fit.pull]))
    taken = unpainted = cross.T @ inner[:, :d]  # by what the light could do instead
    if known is not None:
        free = fit.normal.copy()
        free[range(len(fit.lit)), range(len(fit.lit))] -= known[fit.lit]
        unpainted = cross.T @ np.linalg.solve(free, cross)
    return (weighted @ flat.T).astype(np.float64), taken, unpainted, pull - cross.T @ inner[:, d]


def _weighted(fit: Fit, slopes: Images) -> tuple[Images, Images]:
    """(D, pixels) slopes in the fit's window, and times its weights."""
    flat = slopes[:, *fit.window].reshape(len(slopes), -1)
    return flat, flat * fit.weight[fit.window].ravel()


def _cross(fit: Fit, weighted: Images) -> Array:
    """(M, D) curvature by an unknown of the light and by the pose."""
    return (fit.columns.reshape(len(fit.columns), weighted.shape[1]) @ weighted.T).astype(np.float64)


def paint_variance(fit: Fit, slopes: Images, covariance: Array) -> Array:
    """(P,) of the log of each plane's paint, the gain given, at a pose of (D, D) ``covariance``; infinite where unlit.

    Of a joint normal of light a and pose z with curvatures A, C, Z the covariance of a is A^-1 + B cov(z) B',
    B = A^-1 C: paint is learnt from a pose that may be wrong.
    """
    n = len(fit.lit)
    kept = np.delete(np.arange(len(fit.normal)), n)
    light = np.linalg.inv(fit.normal[np.ix_(kept, kept)])[:n]
    leans = light @ _cross(fit, _weighted(fit, slopes)[1])[kept]
    out = np.full(len(fit.coefficients) - EVEN_PLANES, np.inf)
    out[fit.lit] = np.diag(light) + np.sum((leans @ covariance) * leans, axis=1)
    return out


def scale_seen(chi2: float) -> float:
    """What is left over says how far the discrepancy is from the one believed: as much as was known of it before."""
    known, seen = POSE_DEGREES_OF_FREEDOM, CHI2_DEGREES_OF_FREEDOM
    return (known + seen * chi2) / (known + seen)


@lru_cache(maxsize=64)
def _weak(d: int) -> Array:
    """(d,) precisions far wider than any image allows: they keep the matrix regular."""
    return np.concatenate([np.full(3, 1.0), np.full(2, 1e-4), [1.0], np.full(d - 6, 1e-4)])


def _prior(hill: Hill, poses: Poses, suns: Array) -> tuple[Array, Array]:
    """Curvature (N, D, D) and slope (N, D) of what is told beside the frame."""
    told, n, d = hill.told, len(poses), 6 + poses.joints.shape[1]
    normal, pull = np.zeros((2, n, d + 2 * hill.sun_free, d + 2 * hill.sun_free))
    pull = pull[:, 0]
    normal[:, range(d), range(d)] += _weak(d)
    if told.log_scale is not None:
        normal[:, 5, 5] += told.log_scale_sigma**-2
        pull[:, 5] += (told.log_scale - poses.log_scale) / told.log_scale_sigma**2
    if told.tracking is not None:
        for k, sun in enumerate(suns):
            off, slopes = told.tracking.slopes(poses[k : k + 1], sun)
            normal[k, :d, :d] += slopes.T @ slopes
            pull[k, :d] -= slopes.T @ off
    if hill.sun_free:
        sure = 1.0 if told.towards_sun is None else told.sun_sigma**-2
        normal[:, range(d, d + 2), range(d, d + 2)] += sure
        for k, sun in enumerate(suns if told.towards_sun is not None else ()):
            pull[k, d:] += across(sun) @ (told.towards_sun - sun) * sure
    return normal, pull


def _add_believed_poses(believed: Believed, at: NDArray[np.intp], poses: Poses, normal: Array, pull: Array) -> None:
    """What earlier frames say of the poses that are numbered ``at``."""
    d = believed.precision.shape[1]
    normal[:, :d, :d] += believed.precision[at]
    pull[:, :d] -= np.einsum("nij,nj->ni", believed.precision[at], believed.away(poses, at))


def _add_believed_suns(believed: Believed, at: NDArray[np.intp], suns: Array, normal: Array, pull: Array) -> None:
    """What they say of the Suns that go with them."""
    d = believed.precision.shape[1]
    for k, sun in enumerate(suns):
        sure = believed.sun_precision[at[k]]
        normal[k, range(d, d + 2), range(d, d + 2)] += sure
        pull[k, d:] += sure * (across(sun) @ (believed.suns[at[k]] - sun))

"""The linear systems of Gauss-Newton: slopes of the models' images, and what they say of a pose (docs/model.md, 3)."""

from __future__ import annotations

from collections.abc import Sequence
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
    slopes: Sequence[Images],
    believed: Believed | None = None,
    at: NDArray[np.intp] | None = None,
) -> list[tuple[Array, Array, Array]]:
    """Curvature (D, D) and slope (D,) of each log posterior, the linear unknowns eliminated; and the curvature of which
    a spread is stated: with the discrepancy's scale as it is seen, and as if the paint were unknown, since it was
    learnt from poses that erred as this one does.

    D: rotation (rad), place (frame px), log scale, joints, and the Sun (rad, two axes across it) where it is free.
    """
    known = None if believed is None or at is None else believed.paint[at, 1]
    found = [
        _system(hill, poses[k : k + 1], suns[k], fits[k], slopes[k], None if known is None else known[k])
        for k in range(len(poses))
    ]
    if believed is not None and at is not None:
        towards, d = -believed.away(poses, at), believed.precision.shape[1]
        for (normal, pull, stated), precision, away in zip(found, believed.precision[at], towards, strict=True):
            normal[:d, :d] += precision
            stated[:d, :d] += precision
            pull[:d] += precision @ away
        if hill.sun_free and hill.told.towards_sun is None:
            d = 6 + poses.joints.shape[1]
            for k, (normal, pull, stated) in zip(at, found, strict=True):
                sure, sun = believed.sun_precision[k], suns[np.searchsorted(at, k)]
                normal[range(d, d + 2), range(d, d + 2)] += sure
                stated[range(d, d + 2), range(d, d + 2)] += sure
                pull[d : d + 2] += sure * (across(sun) @ (believed.suns[k] - sun))
    return found


def _system(
    hill: Hill, pose: Poses, sun: Array, fit: Fit, slopes: NDArray[np.float32], known: Array | None
) -> tuple[Array, Array, Array]:
    flat, weighted = _weighted(fit, slopes)
    normal = (weighted @ flat.T).astype(np.float64)
    pull = (weighted @ fit.residual[fit.window].ravel()).astype(np.float64)
    cross = _cross(fit, weighted)
    prior = np.zeros_like(normal)
    _add_prior(hill, prior, pull, pose, sun)
    inner = np.linalg.solve(fit.normal, np.column_stack([cross, fit.pull]))
    d = len(slopes)
    slope = pull - cross.T @ inner[:, d]
    taken = stated = cross.T @ inner[:, :d]  # by what the light could do instead
    if known is not None:
        free = fit.normal.copy()
        free[range(len(fit.lit)), range(len(fit.lit))] -= known[fit.lit]
        stated = cross.T @ np.linalg.solve(free, cross)
    return normal + prior - taken, slope, (normal - stated) / scale_seen(fit.chi2) + prior


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


def _add_prior(hill: Hill, normal: Array, pull: Array, pose: Poses, sun: Array) -> None:
    told, d = hill.told, 6 + pose.joints.shape[1]
    normal[range(d), range(d)] += _weak(d)
    if told.log_scale is not None:
        normal[5, 5] += told.log_scale_sigma**-2
        pull[5] += (told.log_scale - float(pose.log_scale[0])) / told.log_scale_sigma**2
    if told.tracking is not None:
        off, slopes = told.tracking.slopes(pose, sun)
        normal[:d, :d] += slopes.T @ slopes
        pull[:d] -= slopes.T @ off
    if hill.sun_free:
        known = told.towards_sun is not None
        normal[range(d, d + 2), range(d, d + 2)] += told.sun_sigma**-2 if known else 1.0
        if told.towards_sun is not None:
            pull[d : d + 2] += across(sun) @ (told.towards_sun - sun) / told.sun_sigma**2

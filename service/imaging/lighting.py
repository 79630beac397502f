"""How the brightness of a sunlit body changes when its pose does: a direct alignment of frame and model.

Where ``service.imaging.shading`` asks how well one pose explains a frame, this asks in which direction it would do so
better, and how sharply. Edges between faces and the terminator lie inside of the outline, where a blur makes nothing
larger, and they move when the outline hardly does.

What is not known is left free: the sun's direction, an even light, and for each of the largest surfaces a reflectance
of its own (paint and foil differ, some faces glitter, some lie in a shadow). That takes away what only brightness says
and leaves what its edges say.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from service.imaging.shading import OUTLIER, Patch, first_light

Floats = NDArray[np.float64]
Image = NDArray[np.float32]

LEAST_COVERED = 0.2  # of a pixel, after the blur, that counts
EVERY = 4  # pixels are enough for the first light
SURFACES = 12  # of the largest that have a reflectance of their own
REFLECTANCE = 0.4  # standard deviation of it, relative to the body's
USUAL_DISPERSION = 20.0
LEAST_BLUR_PX = 0.5
BLOCK_PX = 12  # of the patch: squares within which residuals are taken to belong together
ROUNDS = 2
LEAST_PIXELS = 50
LIGHT = 4  # numbers that describe it


@dataclass(frozen=True)
class View:
    """One pose, drawn into a patch of S x S pixels, n of which see the body; and how what they see moves with its d
    tangent coordinates."""

    pixel: NDArray[np.intp]  # (n,) row * S + column
    normal: Floats  # (n, 3) unit vectors away from what is seen, camera frame
    depth: Floats  # (n,) smaller is nearer
    surface: NDArray[np.int64]  # (n,) which surface of the body is seen
    flow: Image  # (d, n, 2) px of the patch, x and y, per unit of each coordinate
    turn: Image  # (d, n, 3) change of the normals


@dataclass(frozen=True)
class Alignment:
    """Log-likelihood of the brightness near the pose of a view, to second order."""

    gradient: Floats  # (d,)
    curvature: Floats  # (d, d) of its negative, positive semi-definite
    pixels: float  # that count, as many as are independent of each other


def align(patch: Patch, view: View) -> Alignment | None:
    """One Gauss-Newton step's normal equations (Lucas and Kanade 1981), robust, with the light free beside the pose.

    The brightness is ``shading.explained``'s, times the reflectances. Residuals count by least absolute deviations,
    rounded within ``OUTLIER`` medians. The light is eliminated from the equations, so that what is not known of it
    widens the answer. What the model gets wrong is the same over many pixels: see ``dispersion``. None where too few
    pixels show anything.
    """
    even = np.ones((len(view.pixel), 1))
    spread = _blurred(_spread_out(np.hstack([view.normal, even]), view, patch), patch)
    region = _region(spread[:, 3], patch)
    if len(region) < LEAST_PIXELS:
        return None
    seen = patch.brightness.ravel()[region]
    some = spread[region[::EVERY]].astype(np.float64)
    light = first_light(some, seen[::EVERY].astype(np.float64))
    lit = view.normal @ light[:3] > 0
    brightness = _brightness(view, light)
    largest = np.argsort(-np.bincount(view.surface))[:SURFACES]
    own = np.where(view.surface[:, None] == largest, brightness[:, None], 0.0)
    drawn = _spread_out(np.hstack([view.normal * lit[:, None], even, own]), view, patch)
    basis = _blurred(drawn, patch, region)
    ridge = np.array([0.0] * LIGHT + [USUAL_DISPERSION / REFLECTANCE**2] * len(largest))
    share = np.array([*light, *np.zeros(len(largest))])
    for _ in range(ROUNDS):
        gram, right = _normal_equations(basis, seen - basis @ share.astype(np.float32), seen)
        share = np.linalg.solve(gram + np.diag(ridge + _tiny(gram)), right)
    residual = seen - basis @ share.astype(np.float32)
    gain = np.ones(int(view.surface.max()) + 1)
    gain[largest] += np.clip(share[LIGHT:], -0.9, 3.0)
    motion = _blurred(_motion(view, share[:LIGHT], gain[view.surface], patch), patch, region)
    gram, right = _normal_equations(np.hstack([motion, basis]), residual, residual)
    d = motion.shape[1]
    right[d:] -= ridge * share
    among = gram[d:, d:] + np.diag(ridge + _tiny(gram[d:, d:]))
    across = np.linalg.solve(among, np.column_stack([gram[d:, :d], right[d:]]))
    gradient = right[:d] - gram[:d, d:] @ across[:, d]
    curvature = gram[:d, :d] - gram[:d, d:] @ across[:, :d]
    curvature = 0.5 * (curvature + curvature.T)
    alone = motion - basis @ across[:, :d].astype(np.float32)
    many = dispersion(alone * (_weight(residual) * residual)[:, None], curvature, region, patch)
    return Alignment(gradient / many, curvature / many, len(region) / many)


def dispersion(scores: Image, curvature: Floats, region: NDArray[np.intp], patch: Patch) -> float:
    """How many times less is known than if the residuals of all pixels were independent.

    The scores (n, d) of the pixels ``region`` are summed over squares; what these sums vary by, beside what they would
    if the ``curvature`` were right, is that number (the scalar form of Huber's sandwich, 1967, for clustered data). It
    is no less than the pixels that a point spread joins.
    """
    side = len(patch.brightness)
    across = -(-side // BLOCK_PX)
    square = region // side // BLOCK_PX * across + region % side // BLOCK_PX
    filled = np.flatnonzero(np.bincount(square))
    sums = np.stack([np.bincount(square, one)[filled] for one in scores.T], axis=1)
    sums -= sums.mean(axis=0)
    known = np.linalg.pinv(curvature, rcond=1e-6, hermitian=True)
    variation = np.sum(known * (sums.T @ sums)) / scores.shape[1]
    return max(float(variation), float(4 * np.pi * max(patch.blur_px, LEAST_BLUR_PX) ** 2))


def _tiny(gram: Floats) -> Floats:
    """What keeps the equations of the light solvable where all that is seen faces the same way, or lies in the dark."""
    return np.full(len(gram), 1e-6 * float(np.trace(gram[:LIGHT, :LIGHT])) / LIGHT)


def _region(covered: Image, patch: Patch) -> NDArray[np.intp]:
    """Pixels, row * S + column, where there is light or the pose covers, and those beside them."""
    counted = patch.light | (covered > LEAST_COVERED).reshape(patch.light.shape)
    return np.flatnonzero(cv2.dilate(counted.astype(np.uint8), np.ones((3, 3), np.uint8)))


def _brightness(view: View, light: Floats) -> Floats:
    """(n,) of each pixel that sees the body, before the blur."""
    return np.asarray(np.maximum(view.normal @ light[:3], 0.0) + light[3], np.float64)


def _motion(view: View, light: Floats, gain: Floats, patch: Patch) -> Image:
    """(S * S, d) change of the brightness, before the blur, with each coordinate.

    Every step of brightness between two pixels moves with the nearer of them: an outline hides what is behind it.
    """
    side, n = len(patch.brightness), len(view.pixel)
    brightness = np.zeros(side * side)
    brightness[view.pixel] = _brightness(view, light) * gain
    slot, depth = np.full(side * side, n), np.full(side * side, np.inf)  # slot n: no body, it stands still
    slot[view.pixel], depth[view.pixel] = np.arange(n), view.depth
    change = np.zeros((side * side, len(view.flow)), np.float32)
    change[view.pixel] = ((view.turn @ light[:3]) * (gain * (view.normal @ light[:3] > 0))).T
    index = np.arange(side * side).reshape(side, side)
    for axis, here, there in ((0, index[:, :-1], index[:, 1:]), (1, index[:-1], index[1:])):
        step = 0.5 * (brightness[there] - brightness[here]).ravel()
        some = np.flatnonzero(step)
        a, b = here.ravel()[some], there.ravel()[some]
        flow = np.vstack([view.flow[:, :, axis].T, np.zeros(len(view.flow))])
        moved = flow[np.where(depth[b] < depth[a], slot[b], slot[a])] * step[some, None]
        change[b] -= moved
        change[a] -= moved
    return change


def _normal_equations(columns: Image, residual: Image, wanted: Image) -> tuple[Floats, Floats]:
    """Gram matrix of ``columns`` (n, K) and their products with ``wanted`` (n,), weighted by the ``residual``."""
    weighted = (columns * _weight(residual)[:, None]).T
    return (weighted @ columns).astype(np.float64), (weighted @ wanted).astype(np.float64)


def _weight(residual: Image) -> Image:
    """Second derivatives of a Laplace distribution's log as wide as the residuals (n,), rounded about its peak."""
    size = np.abs(residual)
    width = float(size.mean()) + 1e-9
    return np.asarray(1.0 / (width * np.maximum(size, OUTLIER * np.median(size) + 1e-9)), np.float32)


def _spread_out(values: Floats, view: View, patch: Patch) -> Image:
    """(S * S, K) image of values (n, K) at the pixels that see the body."""
    image = np.zeros((len(patch.brightness) ** 2, values.shape[1]), np.float32)
    image[view.pixel] = values
    return image


def _blurred(image: Image, patch: Patch, region: NDArray[np.intp] | slice = slice(None)) -> Image:
    """(S * S, K) after the patch's point spread, at the pixels of the ``region``."""
    side, out = len(patch.brightness), []
    for k in range(0, image.shape[1], 4):  # OpenCV takes four channels at once
        channels = np.ascontiguousarray(image[:, k : k + 4]).reshape(side, side, -1)
        out.append(cv2.GaussianBlur(channels, (0, 0), patch.blur_px).reshape(side * side, -1)[region])
    return np.concatenate(out, axis=1)

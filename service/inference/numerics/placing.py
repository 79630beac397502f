"""Poses moved across to where a frame shows their light: the air and the mount move a picture as a whole.

One picture a pose is drawn, with the paint that is expected; its brightness, the level of the sky and its place are
fitted, and by day, with another picture, how much of the sky it hides. It costs a third of a look (docs/model.md,
section 3), in which all unknowns of the light are.
"""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np

from service.inference.model import prior
from service.inference.model.drawing import EVEN_PLANES
from service.inference.model.likelihood import t_log_density
from service.inference.model.paint import painted
from service.inference.model.scene import Images
from service.inference.model.spread import spread_slopes
from service.inference.model.terms import Terms
from service.inference.numerics.hill import Hill
from service.inference.numerics.priors import Believed
from service.inference.state import Array, Poses

_ROUNDS = 3  # numerical: of reweighting
_FAINT = 1e-3  # numerical: of the brightest pixel: what is less moves nothing
_ALIKE = 0.7  # numerical: of the greatest likeness: from there steps lead to it
_SOME = ([0], [1], [0, 1])  # exact: of at most two pictures those that are there
_LEAST = 1e-3  # numerical: of the first guess of its light: the body is never thought dark


def placed(hill: Hill, poses: Poses, suns: Array, believed: Believed) -> Poses:
    """The N poses at their best places (frame px), everything else as it is; where nothing is better, as they are."""
    terms = painted(hill.terms, believed.paint)
    p = len(terms.offset)
    mean, variance = terms.facets.expected(terms.mean[:, :p], terms.precision[:, :p])
    bright = np.exp(terms.offset + mean)
    unsure = (np.sum(bright * variance, axis=1) / np.sum(bright, axis=1)).astype(np.float32)  # of a pixel's log light
    pictures = _expected(hill, poses, suns, terms, bright.astype(np.float32))
    whole = np.linalg.inv(believed.precision)[:, 3:5, 3:5] / hill.view.binning**2  # patch px
    away = (poses.position - believed.means.position) / hill.view.binning
    reach = hill.trust.place * hill.drawing.radius * np.exp(poses.log_scale) / hill.view.binning
    known = np.linalg.inv(whole)
    start = _start(terms, pictures[0], known[0], away[0])
    if start.any():
        pictures = np.stack([[_shifted(one, start) for one in parts] for parts in pictures])
    moves = [
        _move(terms, pictures[k], known[k], away[k] + start, float(reach[k]), float(unsure[k]))
        for k in range(len(poses))
    ]
    return replace(poses, position=poses.position + hill.view.binning * (start + np.array(moves).reshape(-1, 2)))


def _start(terms: Terms, parts: Images, precision: Array, away: Array) -> Array:
    """(2,) whole patch px by which pictures (M, 3, S, S) explain the data best; 0 where nearly so as they lie.

    Wherever they may lie their brightness is the likeliest there; ``away`` as they lie from where they are expected.
    """
    pictures = parts[:, 0]
    data = np.where(terms.stars > 0, np.float32(0.0), terms.data)
    precise, mean = _brightness_prior(terms, len(parts))
    likeness = np.fft.irfft2(np.fft.rfft2(data) * np.conj(np.fft.rfft2(pictures)), s=data.shape)
    flat = pictures.reshape(len(parts), -1).astype(np.float64)
    pull = likeness / terms.noise + (precise * mean)[:, None, None]
    normal, nats = flat @ flat.T / terms.noise + np.diag(precise), np.zeros(data.shape)
    for some in _SOME[: 2 * len(parts) - 1]:  # it neither takes light away nor gives the sky more: then it has none
        bright = np.tensordot(np.linalg.inv(normal[np.ix_(some, some)]), pull[some], 1)
        gained = 0.5 * np.sum(bright * pull[some], axis=0)
        nats = np.where((bright >= 0).all(axis=0), np.maximum(nats, gained), nats)
    nats -= 0.5 * float(precise @ mean**2)
    half = len(data) // 2
    shifts = (np.arange(len(data)) + half) % len(data) - half
    off = np.stack(np.meshgrid(shifts, shifts), axis=-1) + away
    nats = nats - 0.5 * np.einsum("yxi,ij,yxj->yx", off, precision, off)
    down, across = np.unravel_index(int(np.argmax(nats)), data.shape)
    if nats[0, 0] >= _ALIKE**2 * nats[down, across]:
        return np.zeros(2)
    return np.array([shifts[across], shifts[down]], np.float64)


def _brightness_prior(terms: Terms, count: int) -> tuple[Array, Array]:
    """(M,) precisions and means of the brightness of the light, and by day of the sky that is hidden."""
    precise, mean = np.full(count, np.exp(-2 * (terms.gain + prior.GAIN_SIGMA))), np.zeros(count)
    precise[1:], mean[1:] = prior.HIDDEN_SIGMA**-2, prior.HIDDEN_MEAN
    return precise, mean


def _expected(hill: Hill, poses: Poses, suns: Array, terms: Terms, positives: Images) -> Images:
    """(N, M, 3, S, S) pictures with their slopes: the body's light, the gain one; by day the sky that it hides, too.

    ``positives`` (N, Q - 4): how bright its surfaces are expected.
    """
    even = np.zeros((len(positives), EVEN_PLANES), np.float32)
    even[:, 0] = terms.mean[:, len(terms.offset) + 1]
    groups = hill.drawing.n_groups
    shares = [np.concatenate([positives[:, :groups], even, positives[:, groups:]], axis=1)]
    if terms.hidden > np.exp(terms.gain):  # by day: the sky is brighter than a white surface
        cover = np.zeros_like(shares[0])
        cover[:, groups] = -terms.hidden
        shares.append(cover)
    drawn = [hill.drawing.combined(poses, suns, share, hill.view, hill.quality) for share in shares]
    pictures = spread_slopes(np.stack(drawn, axis=1), hill.scene.point_spread, hill.scene.smoothing)
    return np.stack(pictures, axis=2)


def _move(terms: Terms, parts: Images, precision: Array, away: Array, reach: float, unsure: float) -> Array:
    """(2,) patch px by which pictures, here with their slopes (M, 3, S, S), lie best; what is expected of it counts."""
    window = _around(parts[-1, 0], reach)
    parts, data, full = parts[..., *window], terms.data[window], terms.full[window]
    starry, m = terms.stars[window] > 0, len(parts)
    if not parts[-1, 0].any():
        return np.zeros(2)
    precise, mean = _brightness_prior(terms, m)
    flat = parts[:, 0].reshape(m, -1).astype(np.float64)
    normal = flat @ flat.T / terms.noise + np.diag(precise)
    bright = np.linalg.solve(normal, flat @ data.ravel() / terms.noise + precise * mean)
    if (bright <= 0).all():  # nothing of it shows
        return np.zeros(2)
    bright = np.maximum(bright, 0.0)
    least, best, highest, move, level = _LEAST * bright[0], np.zeros(2), -np.inf, np.zeros(2), 0.0
    for _ in range(_ROUNDS + 1):
        there = np.stack([_shifted(one, move) for one in parts])
        picture, dx, dy = np.tensordot(bright.astype(np.float32), there, 1)
        light = np.float32(bright[0]) * there[0, 0]
        residual = data - picture - np.float32(level)
        residual[full] = np.maximum(residual[full], 0.0)  # at least so much light
        residual[starry] = np.minimum(residual[starry], 0.0)  # a star's, where it is more
        variance = (terms.noise + terms.photon * np.maximum(light, 0)) / terms.area
        variance = variance + np.float32(terms.wrong + unsure) * light**2
        off, aside = away + move, bright - mean
        score = float(np.sum(t_log_density(residual, variance, full))) / terms.area
        score -= 0.5 * float(off @ precision @ off + precise @ aside**2)
        if score <= highest:
            break
        best, highest = move, score
        weight = (prior.DEGREES_OF_FREEDOM + 1) / ((prior.DEGREES_OF_FREEDOM * variance + residual**2) * terms.area)
        columns = np.stack([*there[:, 0], np.ones_like(light), -dx, -dy]).reshape(m + 3, -1)
        weighted = columns * weight.ravel()
        normal, pull = (weighted @ columns.T).astype(np.float64), (weighted @ residual.ravel()).astype(np.float64)
        normal[:m, :m] += np.diag(precise)
        pull[:m] -= precise * aside
        normal[-2:, -2:] += precision + np.eye(2) / reach**2
        pull[-2:] -= precision @ off
        step = np.linalg.solve(normal, pull)
        bright, level, move = bright + step[:m], level + float(step[m]), move + step[-2:]
        bright = np.maximum(bright, [least, *[0.0] * (m - 1)])
    return best


def _around(picture: Images, reach: float) -> tuple[slice, slice]:
    """Rows and columns of what a picture shows, and as far about it as it may move in a few steps."""
    shown = np.abs(picture)
    more, bright = int(np.ceil(2 * reach)), shown >= _FAINT * shown.max()
    spans = (np.flatnonzero(bright.any(axis=axis)) for axis in (1, 0))
    rows, columns = (slice(max(int(at[0]) - more, 0), int(at[-1]) + 1 + more) for at in spans)
    return rows, columns


def _shifted(pictures: Images, move: Array) -> Images:
    """(K, S, S) moved by (2,) px; beyond the border is nothing."""
    if not move.any():
        return pictures
    matrix = np.array([[1.0, 0.0, move[0]], [0.0, 1.0, move[1]]])
    return np.stack([cv2.warpAffine(one, matrix, one.shape[::-1], flags=cv2.INTER_LINEAR) for one in pictures])

"""Banks of templates: drawn in two passes (a draft for the moments, then the picture), matched in one product."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from service.inference.model import templates as T
from service.inference.model.drawing import Drawing, Quality, View
from service.inference.model.prior import Around
from service.inference.model.spread import LEAST, band
from service.inference.model.sun_tracking import SunTracking
from service.inference.state import Array, Poses

Images = NDArray[np.float32]

_SHIFTS_PX = (-1.0, 0.0, 1.0)  # numerical: of a template, either way, that are tried
_SCALES = (0.72, 0.85, 1.0, 1.18, 1.39)  # numerical: of the moments' size: parts of a body may be dark
_DRAFT = Quality(supersample=1, shadow_px=64, gloss=())  # numerical: from which moments are taken
_PICTURE = Quality(supersample=3, shadow_px=128, gloss=())  # numerical: of a template
_LIT_SHARES = (0.0, 0.08, 0.3)  # numerical: of the brighter light: lit from here on
_FLOOR_SIGMAS = 2.5  # numerical: of a pixel's noise: what is below is no light
_DARK_SIGMAS = 6.0  # numerical: brightest pixels below it: darker than the sky
_HALF_STEP = 0.09  # numerical: of the scales, log
_PER_LOG_SCALE = 0.5  # numerical: correlation that a look may lose for a scale e times off
_BRIGHTEST, _DARKEST = 0.97, 0.995  # numerical: quantiles that stand for the brightest pixels, of light and of all
_AROUND, _LEAST_AROUND_PX = 0.45, 0.4  # numerical: width of a look's sampling, template px, frame px
_BEYOND = (1.25, 1.5, 1.8)  # numerical: times as long as what is seen of it: a body that goes on where nothing is
_KNOWN = 0.5  # numerical: share of a template's pixel that is seen
_LEAST_SHOWN = 0.2  # numerical: of a template's variance, in what is seen: less of it tells nothing
_CHUNK = 512  # numerical: templates drawn at once


def build(
    drawing: Drawing,
    suns: Array,
    tracking: SunTracking | None,
    around: Around,
) -> T.Bank:
    """Draw as many templates as ``suns`` (N, 3), in camera axes, has rows; ``tracking``: joints that follow them.

    ``around``: other light (``prior.LightPrior.whole``).
    """
    count = len(suns)
    quaternion = T.rotations(count)
    joints = T.drawn_joints(drawing.articulation, count)
    draft = View((0.0, 0.0), 1.0, T._FIRST_SIDE, around=around)
    middle = np.full((count, 2), T._FIRST_SIDE / 2)
    size = np.full(count, np.log(0.5 * T._FIRST_SIDE / drawing.radius))
    first = Poses(quaternion, middle, size, joints)
    if tracking is not None:
        first = tracking.pointed(first, suns)
        joints = first.joints
    with ThreadPoolExecutor(1) as other:  # the next pictures are drawn meanwhile
        looks = [other.submit(T.lit_moments, light) for light, _ in _draw(drawing, first, suns, draft, _DRAFT)]
        centre, rim = (np.concatenate(part) for part in zip(*[one.result() for one in looks], strict=True))
        zoom = T._RIM_PX / rim
        poses = Poses(quaternion, (middle - centre) * zoom[:, None] + T.SIDE / 2, size + np.log(zoom), joints)
        view = View((0.0, 0.0), 1.0, T.SIDE, around=around)
        kinds, done, made = np.empty((len(T.KINDS), count, T.SIDE**2), np.float32), 0, []
        for light, outline in _draw(drawing, poses, suns, view, _PICTURE):
            made.append(other.submit(T.kinds_of, light, outline, kinds[:, done : done + len(light)]))
            done += len(light)
        for one in made:
            one.result()
    return T.Bank(suns, poses, kinds)


def _draw(drawing: Drawing, poses: Poses, suns: Array, view: View, quality: Quality) -> Iterator[tuple[Images, Images]]:
    for first in range(0, len(poses), _CHUNK):
        moved = drawing.transforms(poses[first : first + _CHUNK], view)
        sizes = {"side": view.side, "supersample": quality.supersample, "shadow_px": quality.shadow_px}
        drawn = drawing.shaded.pictures(moved, suns[first : first + _CHUNK], **sizes, around=view.around)
        yield drawn[:, 0], drawn[:, 1]


@dataclass(frozen=True)
class Looks:
    """V ways to see the frame as a template: each maps template px to frame px as zoom * p + offset."""

    pictures: Images  # (kinds, V, SIDE * SIDE)
    zoom: Array  # (V,)
    offset: Array  # (V, 2)
    known: Images | None = None  # (V, SIDE * SIDE) 1 where the frame shows what is there, else 0; None: everywhere


def looks(image: Images, sigma: float) -> Looks:
    """The frame's light (S, S; counts, noise ``sigma``) at several shifts and scales about its own moments.

    What is lit is taken in several ways: a dim panel or a thin boom moves the moments of faint light, not of bright.
    """
    above, floor = _lit(image, sigma)
    some = above > 0
    top = float(np.quantile(above[some], _BRIGHTEST)) if some.any() else 1.0
    ways: list[tuple[Array, float]] = []
    for share in _LIT_SHARES:
        mask = above > max(share * top, floor)
        if mask.any():
            centre, rim = (m[0] for m in T.lit_moments(mask[None].astype(np.float32)))
            ways += [(centre, zoom) for zoom in float(rim) / T._RIM_PX * np.array(_SCALES)]
    return _sampled(above, ways)


def looks_beyond(image: Images, sigma: float, unseen: NDArray[np.bool_]) -> Looks:
    """The same light as that of bodies that go on where nothing is seen (S, S), if it touches that; else no look.

    What is seen ends where it ends, so a longer body lies further on towards where the light touches.
    """
    above, _ = _lit(image, sigma)
    some = above > 0
    touching = some & (cv2.dilate(unseen.astype(np.uint8), np.ones((3, 3), np.uint8)) > 0)
    ways: list[tuple[Array, float]] = []
    if touching.any():
        centre, rim = (m[0] for m in T.lit_moments(some[None].astype(np.float32)))
        towards = T.lit_moments(touching[None].astype(np.float32))[0][0] - centre
        towards /= max(float(np.hypot(*towards)), 1e-6)
        along = (np.argwhere(some)[:, ::-1] + 0.5 - centre) @ towards
        middle, long = 0.5 * (along.max() + along.min()), along.max() - along.min()
        for times in _BEYOND:
            there = centre + (middle + 0.5 * (times - 1) * long) * towards
            ways.append((there, times * float(rim) / T._RIM_PX))
    return _sampled(above, ways, unseen)


def _lit(image: Images, sigma: float) -> tuple[Images, float]:
    """(S, S) light that is more than noise, or by day what differs from the sky; and the least that is."""
    smooth, floor = _blurred(image, 1.0), _FLOOR_SIGMAS * sigma
    above = np.where(np.abs(smooth) > floor, np.abs(smooth) if _is_dark(smooth, sigma) else smooth, 0.0)
    return np.maximum(above, 0).astype(np.float32), floor


def _sampled(above: Images, ways: Sequence[tuple[Array, float]], unseen: NDArray[np.bool_] | None = None) -> Looks:
    """Light as templates see it about centres (2,) at zooms, at several shifts of each."""
    planes = [above, (above > 0).astype(np.float32)] + ([] if unseen is None else [(~unseen).astype(np.float32)])
    zooms, offsets, pictures = list[float](), list[Array](), [list[Images]() for _ in planes]
    for centre, zoom in ways:
        tried = centre + zoom * np.array(_SHIFTS_PX)[:, None] - zoom * T.SIDE / 2  # (shifts, 2)
        across, down = (_sampling(len(above), zoom, tried[:, k]) for k in (0, 1))  # (shifts * S, size)
        for plane, to in zip(planes, pictures, strict=True):
            seen = np.asarray(down @ plane @ across.T, np.float32)
            each = seen.reshape(len(tried), T.SIDE, len(tried), T.SIDE)
            to.append(each.transpose(2, 0, 1, 3))  # across, down, S, S
        x, y = np.meshgrid(tried[:, 0], tried[:, 1], indexing="ij")
        offsets.append(np.column_stack([x.ravel(), y.ravel()]))
        zooms += [zoom] * x.size
    if not zooms:  # no light: nothing to go by
        return Looks(np.zeros((len(T.KINDS), 0, T.SIDE**2), np.float32), np.empty(0), np.empty((0, 2)))
    light, outline, *known = (np.concatenate(part).reshape(-1, T.SIDE, T.SIDE) for part in pictures)
    shown = None if not known else (known[0] > _KNOWN).reshape(len(zooms), -1).astype(np.float32)
    return Looks(T.kinds_of(light, outline), np.array(zooms), np.concatenate(offsets), shown)


def _is_dark(smooth: Images, sigma: float) -> bool:
    """By day a body can be darker than the sky: then what differs is what is seen."""
    return bool(smooth.sum() < 0 or np.quantile(smooth, _DARKEST) < _DARK_SIGMAS * sigma)


def _blurred(image: Images, sigma: float) -> Images:
    matrix = band(len(image), sigma)
    return np.asarray(matrix @ image @ matrix, np.float32)


def _sampling(size: int, zoom: float, offsets: Array) -> Images:
    """(K * SIDE, size) means of the frame's pixels around each template pixel's centre, a Gaussian half of it wide."""
    at = zoom * (np.arange(T.SIDE) + 0.5) + offsets[:, None]
    wide = max(_AROUND * zoom, _LEAST_AROUND_PX)
    weight = np.exp(-0.5 * ((np.arange(size) + 0.5 - at.reshape(-1, 1)) / wide) ** 2)
    weight[weight < LEAST] = 0.0
    return np.asarray(weight / (wide * np.sqrt(2 * np.pi)), np.float32)


def match(
    bank: T.Bank,
    seen: Looks,
    log_scale: float | None = None,
    log_scale_sigma: float = 0.0,
    kept: int | None = None,
) -> tuple[Array, list[Poses]]:
    """(kinds, N) best correlation of each template, and the pose that it means at its best look of each kind.

    A told scale prefers looks that agree with it (within three sigma and half a step of the scales).
    ``kept``: no more of each kind are compared in full; which ones, and what of others is told, is what their principal
    pictures say.
    """
    scores, poses = [], []
    if not len(seen.zoom):
        nothing = np.full((len(bank.pictures), len(bank.poses)), -1.0)
        return nothing, [bank.poses] * len(bank.pictures)
    off: Images | None = None
    if log_scale is not None:
        scale = bank.poses.log_scale[:, None] + np.log(seen.zoom)[None]  # (N, V)
        wide = 3 * log_scale_sigma + _HALF_STEP
        off = _PER_LOG_SCALE * np.maximum(np.abs(scale - log_scale) - wide, 0.0).astype(np.float32)
    few = min(kept or len(bank.poses), len(bank.poses))
    principal = bank.principal if few < len(bank.poses) and seen.known is None else None

    def likest(kind: int) -> tuple[Images, NDArray[np.intp]]:
        templates, pictures = bank.pictures[kind], seen.pictures[kind]
        if seen.known is not None:
            return _greatest(_correlated(templates, pictures, seen.known), off)
        if principal is None:
            return _greatest(templates @ pictures.T, off)
        basis, shares = (one[kind] for one in principal)
        score, best = _greatest(shares @ (pictures @ basis).T, off)
        near = np.argpartition(-score, few)[:few]
        score[near], best[near] = _greatest(templates[near] @ pictures.T, None if off is None else off[near])
        return score, best

    with ThreadPoolExecutor(len(seen.pictures)) as pool:
        found = list(pool.map(likest, range(len(seen.pictures))))
    for score, best in found:
        scores.append(score)
        zoom = seen.zoom[best]
        position = bank.poses.position * zoom[:, None] + seen.offset[best]
        size = bank.poses.log_scale + np.log(zoom)
        if log_scale is not None:
            size = np.clip(size, log_scale - wide, log_scale + wide)
        poses.append(Poses(bank.poses.quaternion, position, size, bank.poses.joints))
    return np.stack(scores).astype(np.float64), poses


def _correlated(templates: Images, pictures: Images, known: Images) -> Images:
    """(N, V) correlations of templates (N, P) with looks (V, P), over the pixels that each look knows (V, P)."""
    count = np.maximum(known.sum(axis=1), 1.0)
    seen = known * (pictures - ((known * pictures).sum(axis=1) / count)[:, None])
    length = np.maximum(np.sqrt((seen**2).sum(axis=1)), 1e-6)
    own = np.square(templates) @ known.T - np.square(templates @ known.T) / count
    return np.asarray((templates @ seen.T) / (length * np.sqrt(np.maximum(own, _LEAST_SHOWN))), np.float32)


def _greatest(product: Images, off: Images | None) -> tuple[Images, NDArray[np.intp]]:
    """(N,) greatest of each row, what is off it taken away, and where it is."""
    if off is not None:
        product -= off
    best = np.argmax(product, axis=1)
    return np.take_along_axis(product, best[:, None], 1)[:, 0], best

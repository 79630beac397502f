"""Banks of templates: drawn in two passes (a draft for the moments, then the picture), matched in one product."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from service.inference.model import templates as T
from service.inference.model.drawing import Drawing, Quality, View
from service.inference.state import Array, Poses

Images = NDArray[np.float32]

_SHIFTS_PX = (-2.0, 0.0, 2.0)
_SCALES = (0.72, 0.85, 1.0, 1.18, 1.39)
_DRAFT = Quality(supersample=1, shadow_px=64, gloss=())
_PICTURE = Quality(supersample=2, shadow_px=128, gloss=())
_CHUNK = 512


def build(drawing: Drawing, sun: Array, count: int) -> T.Bank:
    """Draw ``count`` templates under a Sun (3,) in camera axes."""
    quaternion = T.rotations(count)
    joints = T.drawn_joints(drawing.articulation, count)
    draft = View((0.0, 0.0), 1.0, T._FIRST_SIDE)
    middle = np.full((count, 2), T._FIRST_SIDE / 2)
    size = np.full(count, np.log(0.5 * T._FIRST_SIDE / drawing.radius))
    first = Poses(quaternion, middle, size, joints)
    centre, rim = (np.concatenate(p) for p in zip(*(T.lit_moments(light) for light, _ in _draw(drawing, first, sun, draft, _DRAFT)), strict=True))
    zoom = T._RIM_PX / rim
    poses = Poses(quaternion, (middle - centre) * zoom[:, None] + T.SIDE / 2, size + np.log(zoom), joints)
    view = View((0.0, 0.0), 1.0, T.SIDE)
    kinds = [T.kinds_of(light, outline) for light, outline in _draw(drawing, poses, sun, view, _PICTURE)]
    return T.Bank(poses, np.ascontiguousarray(np.concatenate(kinds, axis=1)))


def _draw(drawing: Drawing, poses: Poses, sun: Array, view: View, quality: Quality):
    for first in range(0, len(poses), _CHUNK):
        part = poses[first : first + _CHUNK]
        drawn = drawing.shaded.pictures(
            drawing.transforms(part, view), sun, side=view.side, supersample=quality.supersample, shadow_px=quality.shadow_px
        )
        yield drawn[:, 0], drawn[:, 1]


@dataclass(frozen=True)
class Looks:
    """V ways to see the frame as a template: each maps template px to frame px as zoom * p + offset."""

    pictures: Images  # (kinds, V, SIDE * SIDE)
    zoom: Array  # (V,)
    offset: Array  # (V, 2)


def looks(image: Images, sigma: float) -> Looks:
    """The frame's light (H, W; counts, noise ``sigma``) at several shifts and scales about its own moments."""
    smooth = cv2.GaussianBlur(image, (0, 0), 1.0)
    signal = np.abs(smooth) if smooth.sum() < 0 or np.quantile(smooth, 0.995) < 6 * sigma else smooth
    floor = 2.0 * sigma
    cleaned = np.where(np.abs(smooth) > floor, signal, 0.0).astype(np.float32)
    top = float(np.quantile(cleaned[cleaned > 0], 0.97)) if (cleaned > 0).any() else 1.0
    mask = (cleaned > max(T._LIT * top, floor)).astype(np.float32)
    centre, rim = (m[0] for m in T.lit_moments(mask[None] * 1.0))
    zooms, offsets, pictures, outlines = [], [], [], []
    for scale in _SCALES:
        zoom = float(rim) / T._RIM_PX * scale
        for dx in _SHIFTS_PX:
            for dy in _SHIFTS_PX:
                offset = centre + np.array([dx, dy]) * zoom - zoom * T.SIDE / 2
                matrix = np.array([[zoom, 0, offset[0] + 0.5 * zoom - 0.5], [0, zoom, offset[1] + 0.5 * zoom - 0.5]])
                flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
                blurred = cv2.GaussianBlur(cleaned, (0, 0), max(0.3, 0.4 * zoom))
                pictures.append(cv2.warpAffine(blurred, matrix, (T.SIDE, T.SIDE), flags=flags))
                outlines.append(cv2.warpAffine(mask, matrix, (T.SIDE, T.SIDE), flags=flags))
                zooms.append(zoom)
                offsets.append(offset)
    kinds = T.kinds_of(np.maximum(np.stack(pictures), 0), np.stack(outlines))
    return Looks(kinds, np.array(zooms), np.array(offsets))


def match(bank: T.Bank, seen: Looks, log_scale: float | None = None, log_scale_sigma: float = 0.03) -> tuple[Array, Poses]:
    """(kinds, N) best correlation of each template, and the pose that it means at its best look of each kind.

    A told scale keeps the looks that agree with it (within three sigma and half a step of the scales).
    """
    scores, poses = [], []
    scale = bank.poses.log_scale[:, None] + np.log(seen.zoom)[None]  # (N, V)
    allowed = np.ones(scale.shape, bool)
    if log_scale is not None:
        allowed = np.abs(scale - log_scale) < 3 * log_scale_sigma + 0.09
    for templates, pictures in zip(bank.pictures, seen.pictures, strict=True):
        product = np.where(allowed, templates @ pictures.T, -1.0)
        best = np.argmax(product, axis=1)
        scores.append(np.take_along_axis(product, best[:, None], 1)[:, 0])
        zoom = seen.zoom[best]
        position = bank.poses.position * zoom[:, None] + seen.offset[best]
        poses.append(Poses(bank.poses.quaternion, position, bank.poses.log_scale + np.log(zoom), bank.poses.joints))
    return np.stack(scores).astype(np.float64), poses

"""A frame before clutter, as its filter is given it (``service.inference.clutter.step.Cluttered``)."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import cv2
import numpy as np
from numpy.typing import NDArray

from gpu.lens import NO_LENS, seen_through, where_seen
from gpu.mesh import Mesh
from gpu.zbuffer import rasterise
from service.imaging.clutter import SIZES, Bins, Map, Palette, edges, features, levels, palette_of
from service.inference.articulation import Articulation, part_transforms
from service.inference.clutter.first import Box, Square
from service.inference.clutter.flow import OnBody, Picture
from service.inference.clutter.outlook import Outlook
from service.inference.model.drawing import Drawing, Images, Lens, View
from service.inference.state import Array, Clutter, FilterState, Poses

_ELSEWHERE = -1.0  # log c of what is not looked at: beyond the frame, or the box that was told
_LEAST_SLOPE = 0.5  # numerical: levels a pixel: of noise
_RIM_PX = 1.0  # numerical: of an outline that is neither the body's nor clutter's for sure


@dataclass(frozen=True)
class ClutteredFrame:
    """One frame (H, W) or (H, W, 3), or its part about the body; ``only``: the body lies in this box."""

    image: NDArray[np.generic]
    palette: Palette
    only: Box | None = None
    lens: Lens | None = None
    corner: tuple[int, int] = (0, 0)  # of the part's first pixel in the frame

    @staticmethod
    def of(
        image: NDArray[np.generic], box: tuple[int, int, int, int], state: FilterState | None, lens: Lens | None
    ) -> ClutteredFrame:
        """A frame after a state; in the first one the body lies in the box that was told."""
        held = None if state is None else state.clutter
        if held is None or held.body.shape != (SIZES[0] if image.ndim == 3 else SIZES[1],):
            return ClutteredFrame(image, palette_of(image, box), box, lens)
        palette, side = Palette(held.body, held.clutter, held.low, held.span), len(held.picture)
        x, y = (int(value) for value in held.corner)
        left, top = max(x - side, 0), max(y - side, 0)  # it does not move by more than what was looked at
        part = image[top : max(y + 2 * side, 0), left : max(x + 2 * side, 0)]
        if not part.size:
            return ClutteredFrame(image, palette, None, lens)
        return ClutteredFrame(part, palette, None, lens, (left, top))

    @cached_property
    def _bins(self) -> Bins:
        return features(self.image, self.palette.low, self.palette.span)

    @cached_property
    def _edges(self) -> NDArray[np.float32]:
        return edges(self.image, self.palette.low, self.palette.span)

    @cached_property
    def _grey(self) -> Map:
        grey = self.image.mean(axis=2) if self.image.ndim == 3 else self.image
        return levels(grey, self.palette.low, self.palette.span)

    @cached_property
    def _log_ratio(self) -> Map:
        out = self.palette.log_ratio(self._bins)
        if self.only is None:
            return out
        x, y, width, height = _rounded(self.only)
        held = np.full_like(out, _ELSEWHERE)
        part = slice(max(y, 0), y + height), slice(max(x, 0), x + width)
        held[part] = out[part]
        return held

    def narrowed(self, box: Box) -> ClutteredFrame:
        """The same, colours learnt as if the body were told to lie in this box."""
        return self._with(palette_of(self.image, _rounded(box)))

    def _with(self, palette: Palette) -> ClutteredFrame:
        """With other colours of the same features."""
        out = replace(self, palette=palette)
        out.__dict__.update(_bins=self._bins, _edges=self._edges, _grey=self._grey)
        return out

    def _cut(self, image: Map, origin: tuple[int, int], across: int, beyond: float) -> Map:
        """(across, across) of an image of the part, ``beyond`` outside of it; ``origin`` in the frame."""
        return _cut(image, (origin[0] - self.corner[0], origin[1] - self.corner[1]), across, beyond)

    def outlook(self, drawing: Drawing, square: Square, side: int) -> Outlook:
        """log c on a patch of at most so many px a side."""
        origin, across, side = _whole(square, side)
        image = self._cut(self._log_ratio, origin, across, _ELSEWHERE)
        corner = float(origin[0]), float(origin[1])
        slopes = np.stack([_smaller(self._cut(one, origin, across, 0.0), side) for one in self._edges])
        mean = max(float(np.sqrt(0.5 * (slopes[0] + slopes[2])).mean()), _LEAST_SLOPE)
        view = View(corner, across / side, side, self.lens)
        return Outlook(drawing, view, _smaller(image, side), slopes / np.float32(mean**2))

    def learnt(self, view: View, inside: Images, kept: float = 0.0) -> ClutteredFrame:
        """The same, body and clutter learnt anew of what is looked at."""
        across = round(view.side * view.binning)
        origin = round(view.origin[0]) - self.corner[0], round(view.origin[1]) - self.corner[1]
        share = cv2.resize(inside, (across, across), interpolation=cv2.INTER_LINEAR)
        share = cv2.GaussianBlur(np.clip(share, 0, 1), (0, 0), _RIM_PX)
        height, width = self._bins.shape
        rows = slice(max(origin[1], 0), max(min(origin[1] + across, height), 0))
        columns = slice(max(origin[0], 0), max(min(origin[0] + across, width), 0))
        bins = self._bins[rows, columns]
        if not bins.size:
            return self
        part = np.asarray(share, np.float32)[rows.start - origin[1] :, columns.start - origin[0] :][
            : bins.shape[0], : bins.shape[1]
        ]
        return self._with(self.palette.learnt(bins, part, kept))

    def picture(self, square: Square) -> tuple[Picture, Array]:
        """Grey levels of a square of the frame, and its first corner."""
        origin, across, _ = _whole(square, round(square[1]))
        return self._cut(self._grey, origin, across, 0.0).astype(np.uint8), np.array(origin, np.float64)

    def remembered(self, picture: Picture, corner: Array) -> Clutter:
        """What the next frame is told."""
        known = self.palette
        return Clutter(known.body, known.clutter, known.low, known.span, picture, corner)


def _rounded(box: Box) -> tuple[int, int, int, int]:
    x, y, width, height = (round(v) for v in box)
    return x, y, max(width, 1), max(height, 1)


def _whole(square: Square, side: int) -> tuple[tuple[int, int], int, int]:
    """First corner, side in whole frame px, and in patch px: rows of whole lanes."""
    (x, y), size = square
    side = max(16, min(side, int(size)) // 16 * 16)
    across = max(round(size), side)
    return (round(x - 0.5 * across), round(y - 0.5 * across)), across, side


def _smaller(image: Map, side: int) -> Map:
    """(side, side) means."""
    return np.asarray(cv2.resize(image, (side, side), interpolation=cv2.INTER_AREA), np.float32)


def _cut(image: Map, origin: tuple[int, int], across: int, beyond: float) -> Map:
    """(across, across) of an image, ``beyond`` outside of it."""
    out = np.full((across, across), beyond, np.float32)
    height, width = image.shape
    x, y = origin
    left, top, right, bottom = max(x, 0), max(y, 0), min(x + across, width), min(y + across, height)
    if left < right and top < bottom:
        out[top - y : bottom - y, left - x : right - x] = image[top:bottom, left:right]
    return out


class Lifting:
    """From places in a frame to points of a body at rest."""

    def __init__(self, mesh: Mesh, articulation: Articulation, lens: Lens | None) -> None:
        self._mesh, self._articulation = mesh, articulation
        self._lens = NO_LENS if lens is None else (lens.focal, *lens.middle)

    def __call__(self, pose: Poses, places: Array) -> OnBody:
        """The points (N) of the nearest faces at places (N, 2), frame px; part -1 where there is none."""
        transforms = part_transforms(self._articulation, pose)[0].astype(np.float64)
        placed = np.concatenate(
            [part.vertices @ t[:, :3].T + t[:, 3] for part, t in zip(self._mesh.parts, transforms, strict=True)]
        )
        corners = seen_through(placed, self._lens)[self._mesh.faces]
        low = np.floor(places.min(axis=0)) - 1
        width, height = (int(v) for v in np.ceil(places.max(axis=0)) - low + 2)
        corners[..., :2] -= low
        seen = rasterise(corners, width, height)
        column, row = (places - low).astype(int).T
        face = seen.face[row, column]
        held = np.flatnonzero(face >= 0)
        part = np.where(face >= 0, self._mesh.part_of[np.maximum(face, 0)], -1)
        points = np.zeros((len(places), 3))
        a, b, c = (corners[face[held], k] for k in range(3))
        edge = np.stack([b - a, c - a], axis=-1)  # (M, 3, 2)
        flat = np.linalg.det(edge[:, :2]) == 0
        edge[flat, :2] = np.eye(2)
        share = np.linalg.solve(edge[:, :2], (places[held] - low - a[:, :2])[..., None])
        depth = a[:, 2] + (edge[:, 2:] @ share)[:, 0, 0]
        there = where_seen(np.column_stack([places[held], depth]), self._lens)
        back = transforms[part[held]]
        points[held] = np.linalg.solve(back[..., :3], (there - back[..., 3])[..., None])[..., 0]
        part[held[flat]] = -1
        return OnBody(points, part)

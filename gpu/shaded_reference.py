"""What ``kernels/shaded.cl`` draws, in NumPy: slow, and easy to read. The two differ only where samples meet edges."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gpu.lens import NO_LENS, Lens, magnified, seen_through, where_seen
from gpu.mesh import Mesh
from gpu.shaded_faces import part_box
from gpu.zbuffer import Visible, rasterise

Floats = NDArray[np.float64]
BIAS_TEXELS = 0.3  # a face this much deeper than what the Sun's view holds is still in the light
STEEPEST = 100.0  # of a face in the Sun's view, texels of depth for each texel
Around = tuple[float, float, float, float]
DARK: Around = (0.0, 0.0, 0.0, 0.0)  # no light from all around
EVEN_PLANES = 4  # coverage, and the mean normal's three parts
_BORDER = 1.0  # texels around the body in the Sun's view
_CAMERA = np.array([0.0, 0.0, -1.0])  # towards it


@dataclass(frozen=True)
class _View:
    """The Sun's view: ``axes`` (3, 4) from samples to texels, ``depth`` (S, S), +inf where nothing is."""

    axes: Floats
    depth: Floats


@dataclass(frozen=True)
class Drawing:
    """How planes are drawn: see ``gpu.shaded.ShadedBody``."""

    side: int
    supersample: int
    shadow_px: int
    gloss: tuple[float, ...] = ()
    lens: Lens = NO_LENS
    around: Around = DARK


def reference_planes(
    mesh: Mesh,
    groups: NDArray[np.integer],
    part_transforms: NDArray[np.floating],
    towards_sun: NDArray[np.floating],
    drawing: Drawing,
    gloss_groups: NDArray[np.integer] | None = None,
) -> Floats:
    """(N, G + 4 + L H, side, side): each group in the Sun's light, coverage, normals (3), each lobe of each gloss."""
    suns = np.broadcast_to(np.asarray(towards_sun, np.float64), (len(part_transforms), 3))
    shine = np.arange(int(groups.max(initial=0)) + 1) if gloss_groups is None else np.asarray(gloss_groups)
    out = np.zeros((len(part_transforms), _n_planes(shine, drawing), drawing.side, drawing.side))
    for k, (one, sun) in enumerate(zip(part_transforms.astype(np.float64), suns, strict=True)):
        out[k] = _draw(mesh, groups, shine, one, sun / np.linalg.norm(sun), drawing)
    return out


def _n_planes(shine: NDArray[np.integer], drawing: Drawing) -> int:
    return len(shine) + EVEN_PLANES + (int(shine.max()) + 1) * len(drawing.gloss)


def _draw(
    mesh: Mesh,
    groups: NDArray[np.integer],
    shine: NDArray[np.integer],
    transforms: Floats,
    sun: Floats,
    drawing: Drawing,
) -> Floats:
    """(G + 4 + L H, side, side) of one pose."""
    fine = drawing.side * drawing.supersample
    placed = transforms * drawing.supersample
    corners, lens = mesh.placed(placed)[mesh.faces], magnified(drawing.lens, drawing.supersample)
    visible = rasterise(seen_through(corners, lens), fine, fine)
    rows, columns = np.nonzero(visible.face >= 0)
    face = visible.face[rows, columns]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-300)
    focal, *middle = lens
    ray = np.column_stack([(corners[:, 0, :2] - middle) / focal, 1.0 + corners[:, 0, 2] / focal])  # to a corner
    normal = np.where(np.sum(normal * ray, axis=1, keepdims=True) > 0, -normal, normal)  # the side that is seen
    cosine = normal @ sun
    lit = (cosine[face] > 0).astype(np.float64)
    if drawing.shadow_px and len(face):
        lit *= _reached(_sun_view(mesh, placed, corners, sun, drawing), visible, normal, sun, lens)
    n_groups, n_shiny = len(shine), int(shine.max()) + 1
    around = np.maximum(normal @ drawing.around[:3] + drawing.around[3], 0.0)
    planes = np.zeros((_n_planes(shine, drawing), fine, fine))
    planes[groups[face], rows, columns] = lit * np.maximum(cosine[face], 0.0) + around[face]
    planes[n_groups, rows, columns] = 1.0
    planes[n_groups + 1 : n_groups + EVEN_PLANES, rows, columns] = normal[face].T
    half_way = sun + _CAMERA
    half_way /= max(float(np.linalg.norm(half_way)), 1e-12)
    for k, exponent in enumerate(drawing.gloss):
        lobe = np.maximum(normal @ half_way, 0.0)[face] ** exponent
        planes[n_groups + EVEN_PLANES + k * n_shiny + shine[groups[face]], rows, columns] = lit * lobe
    size = (drawing.side, drawing.supersample)
    return np.asarray(planes.reshape(len(planes), *size, *size).mean(axis=(2, 4)))


def _sun_axes(sun: Floats) -> Floats:
    """(3, 3) rotation whose rows point aside, down, and away from the Sun."""
    away = -sun
    aside = np.cross([0.0, 1.0, 0.0] if abs(away[1]) < 0.9 else [1.0, 0.0, 0.0], away)
    aside /= np.linalg.norm(aside)
    return np.stack([aside, np.cross(away, aside), away])


def _sun_view(mesh: Mesh, placed: Floats, corners: Floats, sun: Floats, drawing: Drawing) -> _View:
    """Draw the body as the Sun sees it, ``shadow_px`` texels across its diameter, fewer where parts reach beyond."""
    rotation = _sun_axes(sun)
    low, high = np.full(3, np.inf), np.full(3, -np.inf)
    for part, matrix in zip(mesh.parts, placed, strict=True):
        turned, box = rotation @ matrix, part_box(part.vertices)
        middle = turned[:, :3] @ box[:3] + turned[:, 3]
        reach = np.minimum(np.abs(turned[:, :3]) @ box[3:6], _scale(turned) * box[6] * 1.00001)
        low, high = np.minimum(low, middle - reach), np.maximum(high, middle + reach)
    across = max(2.0 * mesh.radius * _scale(placed[0]), float((high - low)[:2].max()), 1e-12)
    zoom = drawing.shadow_px / across
    axes = np.column_stack([zoom * rotation, _BORDER - zoom * low])
    side = drawing.shadow_px + 4
    texels = corners @ axes[:, :3].T + axes[:, 3]
    return _View(axes, rasterise(texels + np.array([0.5, 0.5, 0.0]), side, side).depth)


def _reached(view: _View, visible: Visible, normal: Floats, sun: Floats, lens: Lens) -> Floats:
    """(samples,) share of the Sun that reaches each sample that sees the body.

    The sample's depth is compared with the map's at the four texels around, each where the plane of the sample's
    face meets it, and the answer fades between them.
    """
    rows, columns = np.nonzero(visible.face >= 0)
    face = visible.face[rows, columns]
    points = where_seen(np.column_stack([columns + 0.5, rows + 0.5, visible.depth[rows, columns]]), lens)
    u, v, w = view.axes[:, :3] @ points.T + view.axes[:, 3:]
    cosine = np.maximum(normal @ sun, 1e-6)
    turned = normal @ _sun_axes(sun).T
    slope = np.clip(turned[:, :2] / cosine[:, None], -STEEPEST, STEEPEST)[face]
    most = len(view.depth) - 2
    u, v = np.clip(u, 0, most), np.clip(v, 0, most)
    i, j = v.astype(np.int64), u.astype(np.int64)
    out = np.zeros(len(face))
    for down in (0, 1):
        for right in (0, 1):
            share = (1 - np.abs(v - i - down)) * (1 - np.abs(u - j - right))
            depth = w + (j + right - u) * slope[:, 0] + (i + down - v) * slope[:, 1]
            out += share * (depth - BIAS_TEXELS <= view.depth[i + down, j + right])
    return out


def _scale(matrix: Floats) -> float:
    """Mean stretch of a (3, 4) transform."""
    return float(np.sqrt((matrix[:, :3] ** 2).sum() / 3.0))

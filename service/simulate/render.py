"""Sunlit pictures of a posed body: z-buffer, facet shading, cast shadows, anti-aliasing by finer sampling.

Two lights: the sun, which casts shadows, and the sunlit Earth, which is wide and casts none.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gpu.mesh import Mesh
from gpu.zbuffer import Floats, Visible, rasterise
from service.inference.articulation import Articulation, part_transforms
from service.inference.state import Poses
from service.simulate.materials import SURFACES, Materials, Surface

_SHADOW_SIZE_PX: dict[Materials, int] = {"painted": 512, "mixed": 1024}
_OVERSAMPLE: dict[Materials, int] = {"painted": 3, "mixed": 4}
_EARTH_WRAP = 0.5  # the Earth fills much of a low orbit's sky: it lights what is turned away from its middle, too
_EARTH_ROUGHNESS = 0.7  # such a wide light makes a wide lobe of any
_SHADOW_BIAS_PX = 1.5
_LEAST_COSINE = 0.15


@dataclass(frozen=True)
class Light:
    """The sun and what else lights the body. Directions are in the camera frame (z away from the camera)."""

    phase_deg: float = 20.0
    """Angle between the directions to the sun and to the camera, seen from the body; 0 is full light."""
    sun_roll_deg: float = 35.0
    """Direction of the sun around the line of sight, from the image's x axis towards its y axis."""
    ambient: float = 0.02
    """Light that reaches every face, as a share of the sun's."""
    specular: float = 0.25
    """Strength of the glossy reflection of ``painted`` bodies."""
    shininess: float = 25.0
    """Sharpness of it (Blinn-Phong exponent)."""
    sun: float = 1.0
    """Share of the sun that is not behind the Earth."""
    earth: float = 0.0
    """The sunlit Earth as a second, wide light: its share of the sun's."""
    towards_earth: tuple[float, float, float] = (0.0, 0.0, 1.0)
    """Direction of its middle."""

    def direction(self) -> Floats:
        """(3,) unit vector from the body to the sun: x right, y down, z away."""
        phase, roll = np.deg2rad([self.phase_deg, self.sun_roll_deg])
        sideways = np.sin(phase)
        return np.array([sideways * np.cos(roll), sideways * np.sin(roll), -np.cos(phase)])


@dataclass(frozen=True)
class Picture:
    """Radiance and coverage of the body, (H, W) each; radiance 1 is a white facet that faces the sun."""

    radiance: NDArray[np.float32]
    coverage: NDArray[np.float32]


class Renderer:
    """Renders one body again and again. What its pieces are made of is drawn once, from ``rng``."""

    def __init__(
        self, mesh: Mesh, articulation: Articulation, rng: np.random.Generator, materials: Materials = "painted"
    ) -> None:
        self._articulation = articulation
        self._mesh = mesh
        self._surface = SURFACES[materials](mesh, rng)
        self._shadow_px, self._oversample = _SHADOW_SIZE_PX[materials], _OVERSAMPLE[materials]

    def render(self, poses: Poses, size: tuple[int, int], light: Light) -> Picture:
        """The body at a pose (one of them) in an image of ``size`` (width, height)."""
        oversample = self._oversample
        corners = self._corners(poses) * oversample
        width, height = size[0] * oversample, size[1] * oversample
        visible = rasterise(corners, width, height)
        sun = light.direction()
        radius = self._mesh.radius * float(np.exp(poses.log_scale[0])) * oversample
        centre = np.array([*(poses.position[0] * oversample), 0.0])
        lit = _shadow(corners, visible, sun, centre, radius, self._shadow_px)
        radiance = _shade(corners, visible, light, lit, self._surface)
        covered = (visible.face >= 0).astype(np.float32)
        return Picture(_pixel_means(radiance, oversample), _pixel_means(covered, oversample))

    def _corners(self, poses: Poses) -> Floats:
        transforms = part_transforms(self._articulation, poses)[0].astype(np.float64)
        return np.asarray(self._mesh.placed(transforms)[self._mesh.faces])


def _shade(
    corners: Floats, visible: Visible, light: Light, lit: NDArray[np.bool_], surface: Surface
) -> NDArray[np.float32]:
    """Diffuse light (Lambert) and gloss per facet; the side that is seen is the side that is lit."""
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-300)
    normal = np.where(normal[:, 2:] > 0, -normal, normal)
    direct = _sunlight(normal, light, surface)
    even = surface.diffuse * light.ambient
    if light.earth > 0:
        even = even + light.earth * _earthlight(normal, np.array(light.towards_earth), surface)
    out = np.zeros(visible.face.shape, dtype=np.float32)
    seen = visible.face >= 0
    face = visible.face[seen]
    out[seen] = even[face] + direct[face] * lit[seen]
    return out


def _sunlight(normal: Floats, light: Light, surface: Surface) -> Floats:
    """(F,) light that faces of these normals (F, 3) send to the camera where no shadow falls."""
    sun = light.direction()
    towards_sun = np.maximum(normal @ sun, 0.0)
    if surface.mirror is None or surface.roughness is None:
        gloss = light.specular * np.maximum(normal @ _half_way(sun), 0.0) ** light.shininess * (towards_sun > 0)
        direct = surface.diffuse * towards_sun + gloss
    else:
        direct = surface.diffuse * towards_sun + _gloss(normal, sun, surface.mirror, surface.roughness)
    return np.asarray(direct if light.sun == 1.0 else light.sun * direct)


def _earthlight(normal: Floats, direction: Floats, surface: Surface) -> Floats:
    """(F,) the same of the Earth in a direction (3,), for a strength of 1."""
    earth = direction / np.linalg.norm(direction)
    even = surface.diffuse * np.maximum((normal @ earth + _EARTH_WRAP) / (1.0 + _EARTH_WRAP), 0.0)
    if surface.mirror is None or surface.roughness is None:
        return np.asarray(even)
    return np.asarray(even + _gloss(normal, earth, surface.mirror, np.maximum(surface.roughness, _EARTH_ROUGHNESS)))


def _gloss(normal: Floats, direction: Floats, mirror: Floats, roughness: Floats) -> Floats:
    """(F,) lobe of micro-facets in a light from ``direction`` (3,): D F G / (4 n.v), as a share of a white facet's.

    D: B. Walter et al., *Microfacet models for refraction through rough surfaces* (2007), the GGX distribution;
    G: n.l n.v / max(n.l, n.v), L. and A. Neumann.
    """
    lit, seen = np.maximum(normal @ direction, 0.0), np.maximum(-normal[:, 2], 0.0)
    aligned, square = np.maximum(normal @ _half_way(direction), 0.0), roughness**2
    facets = square / (aligned**2 * (square - 1.0) + 1.0) ** 2  # pi D
    return np.asarray(0.25 * mirror * facets * lit / np.maximum(np.maximum(lit, seen), 1e-12))


def _half_way(direction: Floats) -> Floats:
    """Unit vector half way between a direction and that of the camera."""
    half = direction + np.array([0.0, 0.0, -1.0])
    return np.asarray(half / max(float(np.linalg.norm(half)), 1e-12))


def _pixel_means(fine: NDArray[np.float32], factor: int) -> NDArray[np.float32]:
    height, width = fine.shape[0] // factor, fine.shape[1] // factor
    blocks = fine.reshape(height, factor, width, factor)
    return np.asarray(blocks.mean(axis=(1, 3)), dtype=np.float32)


def _shadow(
    corners: Floats, visible: Visible, sun: Floats, centre: Floats, radius: float, size_px: int
) -> NDArray[np.bool_]:
    """(H, W) whether the sun reaches what each pixel sees: the scene once more, seen from the sun."""
    basis = _sun_basis(sun)
    zoom = size_px / (2.0 * radius)
    middle = np.array([0.5, 0.5, 0.0]) * size_px
    from_sun = (corners - centre) @ basis.T * zoom + middle
    nearest = rasterise(from_sun, size_px, size_px).depth
    rows, columns = np.nonzero(visible.face >= 0)
    points = np.column_stack([columns + 0.5, rows + 0.5, visible.depth[rows, columns]])
    seen = (points - centre) @ basis.T * zoom + middle
    x, y = (np.clip(seen[:, k], 0, size_px - 1).astype(np.int64) for k in (0, 1))
    normal = np.cross(from_sun[:, 1] - from_sun[:, 0], from_sun[:, 2] - from_sun[:, 0])
    cosine = np.abs(normal[:, 2]) / np.maximum(np.linalg.norm(normal, axis=1), 1e-300)
    bias = _SHADOW_BIAS_PX / np.maximum(cosine, _LEAST_COSINE)  # a slanted facet crosses several depths a pixel
    lit = np.zeros(visible.face.shape, dtype=np.bool_)
    lit[rows, columns] = seen[:, 2] <= nearest[y, x] + bias[visible.face[rows, columns]]
    return lit


def _sun_basis(sun: Floats) -> Floats:
    """(3, 3) rotation whose third row points away from the sun."""
    away = -sun
    aside = np.cross([0.0, 1.0, 0.0] if abs(away[1]) < 0.9 else [1.0, 0.0, 0.0], away)
    aside /= np.linalg.norm(aside)
    return np.stack([aside, np.cross(away, aside), away])

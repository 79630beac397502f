"""Pictures by a path tracer, Mitsuba 3: soft shadows of a wide Earth, and light that one face throws on another.

Another program's light than the filter's own, and harder: what holds on its passes was not tuned into them.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from gpu.mesh import Mesh
from gpu.zbuffer import Floats
from service.inference.articulation import Articulation, part_transforms
from service.inference.state import Poses
from service.simulate.materials import SURFACES, Materials
from service.simulate.render import Light, Picture

_SAMPLES = 64  # of a pixel: 2 % of noise in a dim one, less than any telescope's
_BOUNCES = 5
_MIRRORS = 0.3  # of the light: what reflects more is metal, without a diffuse layer below
_EARTH_LIGHTS, _EARTH_RADIUS_DEG = 24, 60.0  # as a low orbit has it: so many lights over a cap of its sky
_GOLDEN_RAD = np.pi * (3.0 - np.sqrt(5.0))
_BEYOND = 4.0  # of the body's radius: where the camera stands


class PathTracingMissingError(RuntimeError):
    """Mitsuba is not installed."""


class PathTracer:
    """Renders one body again and again, as ``render.Renderer`` does. What its pieces are made of is drawn once."""

    def __init__(
        self, mesh: Mesh, articulation: Articulation, rng: np.random.Generator, materials: Materials = "painted"
    ) -> None:
        """Raises ``PathTracingMissingError``."""
        self._mi = _mitsuba()
        self._mesh, self._articulation = mesh, articulation
        surface = SURFACES[materials](mesh, rng)
        none = np.zeros(mesh.n_faces)
        mirror = none if surface.mirror is None else surface.mirror
        rough = none if surface.roughness is None else surface.roughness
        kinds, of_face = np.unique(np.stack([surface.diffuse, mirror, rough], axis=1), axis=0, return_inverse=True)
        self._of_face = of_face.ravel()
        self._materials = [self._mi.load_dict({"type": "twosided", "bsdf": _material(*kind)}) for kind in kinds]

    def render(self, poses: Poses, size: tuple[int, int], light: Light) -> Picture:
        """The body at a pose (one of them) in an image of ``size`` (width, height)."""
        width, height = size
        transforms = part_transforms(self._articulation, poses)[0].astype(np.float64)
        corners = np.asarray(self._mesh.placed(transforms)[self._mesh.faces]) - np.array([width / 2, height / 2, 0.0])
        away = _BEYOND * self._mesh.radius * float(np.exp(poses.log_scale[0]))
        scene = {"type": "scene", **_lights(light), **self._camera(size, away)}
        for kind, material in enumerate(self._materials):
            scene[f"body{kind}"] = self._surface(corners[self._of_face == kind], material)
        image = np.array(self._mi.render(self._mi.load_dict(scene), spp=_SAMPLES, seed=0))
        covered = np.clip(image[:, :, 3], 0.0, 1.0)
        return Picture(np.asarray(image[:, :, :3].mean(axis=2), np.float32), np.asarray(covered, np.float32))

    def _camera(self, size: tuple[int, int], away: float) -> dict[str, Any]:
        """Parallel rays along z; mitsuba's x is to the left, and its image two units wide."""
        width, height = size
        move = self._mi.ScalarTransform4f
        place = move().translate([0.0, 0.0, -away]) @ move().rotate([0, 0, 1], 180.0)
        film = {"type": "hdrfilm", "width": width, "height": height, "pixel_format": "rgba", "rfilter": {"type": "box"}}
        sensor = {
            "type": "orthographic",
            "near_clip": 1e-3 * away,
            "far_clip": 2.0 * away,
            "to_world": place @ move().scale([width / 2, width / 2, 1.0]),
            "film": film,
            "sampler": {"type": "multijitter", "sample_count": _SAMPLES},
        }
        return {"sensor": sensor, "rays": {"type": "path", "max_depth": _BOUNCES + 1, "hide_emitters": True}}

    def _surface(self, corners: Floats, material: Any) -> Any:
        """Faces (F, 3 corners, 3) of one material, each flat."""
        given = self._mi.Properties()
        given["bsdf"], given["face_normals"] = material, True
        mesh = self._mi.Mesh("body", 3 * len(corners), len(corners), props=given)
        values = self._mi.traverse(mesh)
        values["vertex_positions"] = corners.astype(np.float32).ravel()
        values["faces"] = np.arange(3 * len(corners), dtype=np.uint32)
        values.update()
        return mesh


def _mitsuba() -> Any:
    try:
        import mitsuba
    except ImportError as error:
        raise PathTracingMissingError("path tracing needs mitsuba: .venv/bin/pip install mitsuba") from error
    mitsuba.set_variant("scalar_rgb")
    return mitsuba


def _material(diffuse: float, mirror: float, roughness: float) -> dict[str, Any]:
    """Paint or cells under varnish; metal; or, without gloss, chalk."""
    gloss = {"distribution": "ggx", "alpha": float(roughness)}
    if roughness == 0.0:
        return {"type": "diffuse", "reflectance": _grey(diffuse)}
    if mirror > _MIRRORS:
        return {"type": "roughconductor", "material": "none", "specular_reflectance": _grey(mirror), **gloss}
    return {"type": "roughplastic", "diffuse_reflectance": _grey(diffuse), **gloss}


def _lights(light: Light) -> dict[str, Any]:
    """Sun and Earth; a white facet that faces the Sun is 1."""
    out = {"sun": _directional(light.direction(), light.sun)}
    if light.earth > 0:
        for k, direction in enumerate(_cap(np.array(light.towards_earth))):
            out[f"earth{k}"] = _directional(direction, light.earth / _EARTH_LIGHTS)
    if light.ambient > 0:
        out["ambient"] = {"type": "constant", "radiance": _grey(light.ambient)}
    return out


def _directional(towards: Floats, strength: float) -> dict[str, Any]:
    return {"type": "directional", "direction": (-towards).tolist(), "irradiance": _grey(np.pi * strength)}


def _cap(middle: Floats) -> NDArray[np.float64]:
    """(K, 3) directions that share a cap of the sky evenly: a spiral."""
    axis = middle / np.linalg.norm(middle)
    across, along = np.linalg.svd(axis[None])[2][1:]
    share = (np.arange(_EARTH_LIGHTS) + 0.5) / _EARTH_LIGHTS
    height = 1.0 - share * (1.0 - np.cos(np.deg2rad(_EARTH_RADIUS_DEG)))
    turn, aside = _GOLDEN_RAD * np.arange(_EARTH_LIGHTS), np.sqrt(1.0 - height**2)
    return np.asarray(
        height[:, None] * axis + (aside * np.cos(turn))[:, None] * across + (aside * np.sin(turn))[:, None] * along
    )


def _grey(value: float) -> dict[str, Any]:
    return {"type": "rgb", "value": [float(value)] * 3}

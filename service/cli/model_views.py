"""Six views of a model: its surfaces in colours, and lit."""

from __future__ import annotations

import colorsys

import numpy as np
from numpy.typing import NDArray

from gpu.mesh import Mesh
from gpu.shaded import open_shaded
from service.imaging.overlay import encode_png
from service.inference.articulation import Articulation, part_transforms
from service.inference.pose import exp_so3
from service.inference.state import Poses

SIDE = 220
_FILLED = 0.46  # of the side: the body's radius
_SUN = np.array([0.5, -0.4, -0.77])
_VIEWS = ((0, 0, 0), (0, 90, 0), (0, 180, 0), (0, -90, 0), (90, 0, 0), (-90, 0, 0))  # rotation vectors, deg


def views(mesh: Mesh, articulation: Articulation, groups: NDArray[np.int32]) -> bytes:
    """PNG, two rows of six; ``groups`` (F,). Raises ``gpu.errors.DeviceError`` where there is no OpenCL."""
    count = len(_VIEWS)
    poses = Poses(
        exp_so3(np.deg2rad(np.array(_VIEWS, dtype=np.float64))),
        np.full((count, 2), SIDE / 2),
        np.full(count, np.log(_FILLED * SIDE / mesh.radius)),
        np.repeat(articulation.initial[None], count, axis=0),
    )
    drawn = open_shaded(mesh, groups)
    try:
        sun = np.tile(_SUN / np.linalg.norm(_SUN), (count, 1))
        transforms = part_transforms(articulation, poses).astype(np.float32)
        planes = drawn.planes(transforms, sun, side=SIDE, supersample=3, shadow_px=384, gloss=())
    finally:
        drawn.close()
    n = int(groups.max()) + 1
    light, even = planes[:, :n], planes[:, n]
    hues = np.array([colorsys.hsv_to_rgb((0.61803 * k) % 1, 0.65, 1.0) for k in range(n)])
    colours = np.einsum("ngyx,gc->nyxc", light, hues) + 0.12 * even[..., None]
    grey = np.repeat((light.sum(axis=1) + 0.04 * even)[..., None], 3, axis=-1)
    rows = [np.concatenate(list(one), axis=1) for one in (colours, grey)]
    picture = np.clip(np.concatenate(rows) * 255, 0, 255).astype(np.uint8)
    return encode_png(np.ascontiguousarray(picture))

"""A small body with a panel on a joint, in the Sun: what the tests of the light's model draw and believe."""

import functools
from dataclasses import replace

import numpy as np

from gpu.evidence import open_evidence
from gpu.mesh import Mesh, assemble
from gpu.raw_part import RawPart
from gpu.shaded import open_shaded
from gpu.slopes import open_slopes
from gpu.surface_groups import surface_groups
from service.inference.articulation import Articulation, Joint, Stage
from service.inference.model.drawing import Drawing, Quality, View
from service.inference.model.scene import Scene
from service.inference.model.spread import PointSpread, spread
from service.inference.pose import exp_so3
from service.inference.state import Poses

SIDE = 64
VIEW = View((100.0, 60.0), 1.0, SIDE)  # of a frame
QUALITY = Quality(supersample=4, shadow_px=192)
SUN = np.array([0.5, -0.35, -0.79]) / np.linalg.norm([0.5, -0.35, -0.79])
FINEST = 0.05  # px: a low pass that leaves the frame as it is, so that its noise is white
FACES = [(0, 1, 3), (0, 3, 2), (4, 6, 7), (4, 7, 5), (0, 4, 5), (0, 5, 1)]
FACES += [(2, 3, 7), (2, 7, 6), (0, 2, 6), (0, 6, 4), (1, 5, 7), (1, 7, 3)]


def box(name: str, size, centre) -> RawPart:
    corners = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]) * np.array(size) / 2
    return RawPart(name, corners + np.array(centre), np.array(FACES))


def lit_mesh() -> tuple[Mesh, Articulation]:
    """A bus with a boom, and a panel that turns about y by ``panel`` degrees."""
    parts = [box("bus", (1.0, 1.4, 0.8), (0, 0, 0)), box("boom", (0.16, 0.16, 1.3), (0.3, -0.5, 1.0))]
    parts.append(box("panel", (0.8, 2.0, 0.04), (0.0, 1.8, 0.0)))
    mesh = assemble(parts)
    origin = tuple(-c for c in mesh.centre)
    turn = Stage("revolute", ("panel",), (0.0, 1.0, 0.0), origin)
    joint = Joint("panel", "revolute", -180.0, 180.0, 0.0, (turn,))
    return mesh, Articulation(("bus", "boom", "panel"), (joint,))


@functools.cache
def lit_body() -> Drawing:
    """The mesh on a CPU, its panel free."""
    mesh, articulation = lit_mesh()
    shaded = open_shaded(mesh, surface_groups(mesh))
    return Drawing(shaded, open_evidence(), articulation, shaded.n_groups, mesh.radius, open_slopes())


def pose(turn=(0.4, -0.7, 0.3), joint=35.0, middle=(32.0, 31.0), rim_px=24.0) -> Poses:
    """One pose, its body in the middle of ``VIEW``."""
    return Poses(
        exp_so3(np.array([turn])),
        np.array([middle]) + np.array(VIEW.origin),
        np.array([np.log(rim_px / lit_body().radius)]),
        np.array([[joint]]),
    )


def shares(drawing: Drawing, gain: float, albedo=(1.0, 1.4, 0.7), even=(0.04, 0.0, 0.0, 0.0), gloss=0.15) -> np.ndarray:
    """(Q,) coefficients of the drawing's planes: counts. ``even``: even light and its tilt."""
    n = drawing.n_groups
    return gain * np.concatenate([np.array(albedo)[:n], even, np.full(n, gloss)]).astype(np.float32)


def seen(at: Poses, coefficients: np.ndarray, sun=SUN, core=1.3, wings=0.0, quality=QUALITY) -> np.ndarray:
    """(S, S) counts of a frame without noise."""
    drawn = lit_body().combined(at, sun, coefficients, VIEW, quality)
    return spread(drawn, PointSpread(core, wings), 0.0)[0]


def scene(image: np.ndarray, sigma: float, core=1.3, wings=0.0, **others) -> Scene:
    """What the likelihood is told of a frame that it has made itself: discrepancy is next to nothing."""
    told = Scene(image.astype(np.float32), sigma, 1e-6, 0.0, np.zeros(image.shape, bool), PointSpread(core, wings))
    return replace(told, **({"discrepancy": 1e-4, "shifts": False} | others))

"""Closed bodies of a wanted number of faces, so that scorers can be compared where no mesh file is at hand."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from gpu.mesh import Mesh, assemble
from gpu.raw_part import RawPart
from service.inference.articulation import Articulation, Joint, Stage
from service.simulate.primitives import Solid, box, cone, dish, merged, rotation_about

WING = "wing"
FACES = (1_000, 7_000, 18_000)  # about
BOX_FACES = 12
_FINEST = 400  # beyond it there are more boxes


def body_of(faces: int) -> Mesh:
    """A bus with tanks, a dish, a boom, thrusters and instruments, and a wing as a part of its own.

    Several components in each part, some of them inside others, as in real models. Of the tessellations within
    ``faces`` it has the finest (or the coarsest that there is), and small boxes for the faces that are left.
    """
    details = range(1, _FINEST)
    detail = next(d for d in details if d + 1 == _FINEST or _count(_parts(d + 1)) > faces)
    bus, wing = _parts(detail)
    bus = merged([bus, *_boxes(max(0, faces - _count((bus, wing))) // BOX_FACES)])
    return assemble([RawPart("bus", bus.vertices, bus.faces), RawPart(WING, wing.vertices, wing.faces)])


def articulation_of(mesh: Mesh) -> Articulation:
    """One joint where the body has a wing, none otherwise."""
    names = tuple(part.name for part in mesh.parts)
    if WING not in names:
        return Articulation(names)
    turn = Stage("revolute", (WING,), (0.0, 1.0, 0.0))
    return Articulation(names, (Joint(WING, "revolute", -180.0, 180.0, 0.0, (turn,)),))


def _parts(detail: int) -> tuple[Solid, Solid]:
    sides, rings = 8 + 4 * detail, 2 + detail
    tank = _ball(0.42, sides, rings)
    bus = [
        box((2.0, 2.0, 2.8)),
        tank.moved((0.55, 0.0, -1.5)),
        tank.moved((-0.55, 0.0, -1.5)),
        dish(1.1, 0.4, 0.05, sides, rings).moved((0.0, 0.0, 1.8)),
        cone(0.06, 0.06, 1.2, 8).moved((0.0, 0.0, 1.5)),
        cone(0.05, 0.05, 2.0, 8).moved((0.0, -1.9, 0.6), rotation_about((1, 0, 0), 80)),
    ]
    for k in range(2 + 2 * detail):
        place = (-1.1, 0.8 * np.sin(1.7 * k), 1.1 * np.cos(2.4 * k))
        bus.append(cone(0.07, 0.12, 0.25, sides).moved(place, rotation_about((0, 1, 0), -90)))
    wing = [box((0.08, 1.0, 0.08)).moved((0.0, 1.3, 0.0))]
    columns = 2 + detail // 2
    for column in range(columns):  # a panel, its frame and its hinges
        centre = 1.6 + 2.8 * (column + 0.5) / columns
        width = 2.8 / columns
        wing.append(box((2.0, 0.94 * width, 0.04)).moved((0.0, centre, 0.0)))
        wing.append(box((0.06, 0.96 * width, 0.1)).moved((1.03, centre, 0.0)))
        wing.append(
            cone(0.05, 0.05, 1.9, sides).moved((0.0, centre + 0.48 * width, 0.0), rotation_about((0, 1, 0), 90))
        )
    return merged(bus), merged(wing)


def _count(solids: Sequence[Solid]) -> int:
    return sum(len(solid.faces) for solid in solids)


def _boxes(count: int) -> list[Solid]:
    """Instruments on one face of the bus."""
    found = []
    for k in range(count):
        size = 0.1 + 0.02 * (k % 7)
        found.append(box((size, 0.3, 1.4 * size)).moved((0.8 * np.cos(2.4 * k), 1.0, 1.1 * np.sin(1.7 * k))))
    return found


def _ball(radius: float, sides: int, rings: int) -> Solid:
    """A closed ball: rings of vertices between two poles."""
    polar = np.pi * np.arange(1, rings + 1) / (rings + 1)
    angle = 2 * np.pi * np.arange(sides) / sides
    ring = np.stack(
        [
            np.outer(np.sin(polar), np.cos(angle)),
            np.outer(np.sin(polar), np.sin(angle)),
            np.repeat(np.cos(polar)[:, None], sides, axis=1),
        ],
        axis=-1,
    ).reshape(-1, 3)
    i = np.arange(sides)
    j = (i + 1) % sides
    last = 1 + rings * sides
    faces = [np.column_stack([np.zeros(sides, dtype=np.int64), 1 + i, 1 + j])]
    for row in range(rings - 1):
        a, b = 1 + row * sides, 1 + (row + 1) * sides
        faces += [np.column_stack([a + i, b + i, b + j]), np.column_stack([a + i, b + j, a + j])]
    low = last - sides
    faces.append(np.column_stack([low + i, np.full(sides, last), low + j]))
    return Solid(radius * np.vstack([[[0, 0, 1]], ring, [[0, 0, -1]]]), np.vstack(faces))

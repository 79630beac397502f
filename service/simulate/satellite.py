"""The bundled demo satellite: a bus with one large wing on a joint, a dish, a boom, each on its own side.

No mirror plane and no rotation leaves it as it is. The wing is off its hinge line and carries a reflector across
its edge, so that every angle of the joint looks different. Metres; +z is up, the wing reaches towards +y.
"""

from __future__ import annotations

import numpy as np

from service.simulate.glb_writer import Hinge, SolidNode, write_glb
from service.simulate.primitives import Solid, Vector, box, cone, dish, merged, prism, rotation_about

NAME = "demo"
JOINT = "wing"
_HINGE: Vector = (0.25, 0.8, 0.35)


def demo_satellite() -> bytes:
    """The satellite as the bytes of a GLB file with one ``AGI_articulations`` joint, ``wing``."""
    return write_glb(NAME, [SolidNode("bus", _bus()), SolidNode("wing", _wing(), _HINGE, Hinge(JOINT, "y"))])


def _bus() -> Solid:
    bevelled = np.array([[-0.6, -0.5], [0.6, -0.5], [0.3, 0.5], [-0.6, 0.5]])
    dish_turn = rotation_about((0, 0, 1), -25) @ rotation_about((0, 1, 0), 90)
    return merged(
        [
            box((2.6, 1.6, 1.5)),
            prism(bevelled, 0.7).moved((0.6, -0.1, 1.05)),
            cone(0.38, 0.38, 1.1).moved((-0.75, 0.2, 1.25)),
            cone(0.08, 0.08, 0.5, 10).moved((1.42, -0.42, -0.1), dish_turn),
            dish(0.95, 0.34, 0.05).moved((1.55, -0.48, -0.1), dish_turn),
            _boom(start=(-1.2, -0.4, -0.5), length=3.4),
            cone(0.5, 0.24, 0.55).moved((-0.1, 0.0, -1.0)),
        ]
    )


def _boom(start: Vector, length: float) -> Solid:
    turn = rotation_about((0, 0, 1), 200) @ rotation_about((0, 1, 0), 115)
    rod = cone(0.07, 0.05, length, 10).moved((0, 0, 0.5 * length))
    sensor = box((0.3, 0.4, 0.35)).moved((0, 0, length))
    return merged([rod, sensor]).moved(start, turn)


def _wing() -> Solid:
    yoke = prism(np.array([[-0.12, -0.1], [0.12, -0.1], [0.45, 1.0], [-0.2, 1.0]]), 0.08)
    panel = box((1.7, 5.2, 0.06)).moved((0.4, 3.55, 0.0))
    # A reflector along one edge: without it the wing tilted towards the camera looks like one tilted away.
    reflector = box((0.06, 3.4, 0.75)).moved((1.22, 2.9, 0.36))
    return merged([yoke, panel, reflector])

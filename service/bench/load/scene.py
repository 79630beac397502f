"""What the sessions of a load benchmark are sent."""

from __future__ import annotations

from dataclasses import dataclass, replace

from gpu.mesh import Mesh
from service.inference.articulation import Articulation
from service.simulate.folder import encode_png
from service.simulate.scenario import PRESETS
from service.simulate.sequence import SimulatedPass


@dataclass(frozen=True)
class Scene:
    """What every session is sent: a pass there and back, so that the body moves smoothly for as long as it takes."""

    file_name: str
    mesh: bytes
    joints: tuple[str, ...]
    backgrounds: tuple[bytes, ...]
    frames: tuple[bytes, ...]
    towards_sun: tuple[float, float, float] | None = None
    """In camera axes, as a telescope knows it that knows its site and the time; None: sessions are not told."""

    def frame(self, index: int) -> bytes:
        """The file of frame ``index``."""
        period = max(2 * len(self.frames) - 2, 1)
        at = index % period
        return self.frames[at if at < len(self.frames) else period - at]


def simulated_scene(
    file_name: str, data: bytes, mesh: Mesh, articulation: Articulation, size: tuple[int, int], frames: int = 24
) -> Scene:
    """A quiet night's pass of a satellite, as PNG files."""
    scenario = PRESETS["demo"]()
    scenario = replace(scenario, size=size, motion=replace(scenario.motion, frames=frames))
    simulated = SimulatedPass(mesh, articulation, scenario)
    names = tuple(joint.name for joint in articulation.joints)
    backgrounds = tuple(encode_png(image) for image in simulated.backgrounds())
    files = tuple(encode_png(image) for image in simulated.frames())
    x, y, z = (float(value) for value in simulated.light(0).direction())
    return Scene(file_name, data, names, backgrounds, files, (x, y, z))

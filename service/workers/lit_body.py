"""A model as the light sees it: drawn on the device from roughly to finely, each with its surface groups."""

from __future__ import annotations

from contextlib import ExitStack
from dataclasses import replace

from gpu.coarse_mesh import coarse_mesh
from gpu.device import first_kind
from gpu.evidence import LightEvidence, open_evidence
from gpu.mesh import Mesh
from gpu.shaded import open_shaded
from gpu.slopes import LightSlopes, open_slopes
from gpu.surface_facets import surface_facets
from gpu.surface_groups import gloss_groups, surface_groups
from service.inference.articulation import Articulation
from service.inference.model.drawing import Drawing
from service.inference.model.stages import Body

ROUGH_GROUPS, ROUGH_RADIUS_PX = 12, 12.0
MIDDLE_GROUPS, MIDDLE_RADIUS_PX = 20, 24.0
"""Numerical: surfaces with an albedo of their own, and how finely meshes are kept, at each of a search's stages."""


class LitBody:
    """One mesh. Owned, used and closed by one thread. Raises ``gpu.errors.DeviceError`` where there is no OpenCL."""

    def __init__(self, mesh: Mesh, articulation: Articulation) -> None:
        self._held = ExitStack()
        with ExitStack() as opening:
            light = open_evidence(_kind())
            opening.callback(light.close)
            slopes = None
            if _kind() == "cpu":  # its kernels take a pose a work-item: a GPU would wait for each
                slopes = open_slopes()
                opening.callback(slopes.close)
            shared = articulation, light, slopes
            rough = _drawing(mesh, *shared, ROUGH_GROUPS, ROUGH_RADIUS_PX, opening)
            middle = _drawing(mesh, *shared, MIDDLE_GROUPS, MIDDLE_RADIUS_PX, opening)
            fine = _drawing(mesh, *shared, None, None, opening)
            self.body = Body(rough, middle, fine)
            self._held = opening.pop_all()

    def articulated(self, articulation: Articulation) -> Body:
        """The same body with other joints free."""
        return Body(
            *(replace(one, articulation=articulation) for one in (self.body.rough, self.body.middle, self.body.fine))
        )

    def close(self) -> None:
        """Give the device's memory back."""
        self._held.close()


def _drawing(
    mesh: Mesh,
    articulation: Articulation,
    light: LightEvidence,
    slopes: LightSlopes | None,
    most: int | None,
    radius_px: float | None,
    held: ExitStack,
) -> Drawing:
    groups = surface_groups(mesh, most=most)
    drawn, pieces, shine = mesh, None, gloss_groups(mesh, groups)
    if most is None:
        groups, pieces = surface_facets(mesh, groups)
        shine = shine[pieces]
    if radius_px is not None:
        drawn, groups = coarse_mesh(mesh, groups, radius_px)
    shaded = open_shaded(drawn, groups, shine, kind=_kind())
    held.callback(shaded.close)
    return Drawing(shaded, light, articulation, shaded.n_groups, mesh.radius, slopes, pieces)


def _kind() -> str:
    """A followed frame has few poses at a time, over which a GPU takes as long: one that others may need is left."""
    return first_kind("cpu", "gpu")

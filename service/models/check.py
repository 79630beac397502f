"""What a filter makes of a mesh, and what in it will hurt."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gpu.mesh import Mesh
from gpu.surface_groups import face_areas, surface_groups
from service.inference.articulation import Articulation
from service.models.symmetry import ModelSymmetries, describe_symmetries

SPACECRAFT_M = (0.1, 150.0)  # largest extent of what is called one: a CubeSat, the ISS
_FAR = 3.0  # of the distances that hold nearly all of the surface: what lies beyond makes the body seem so much larger
_NEARLY_ALL = 0.99
_TINY = 1e-8  # of the whole surface: no picture shows such a face
_MANY_TINY = 0.2
_THIN, _LARGE = 0.05, 0.05  # a panel: so flat beside its length, and so much of the surface
_ONE_SURFACE = 0.6


@dataclass(frozen=True)
class Examination:
    """A mesh as the filter sees it."""

    groups: NDArray[np.int32]  # (F,) surface whose albedo a face shares
    shares: tuple[float, ...]  # of the surface, by group
    size: tuple[float, float, float]  # model units
    symmetries: tuple[str, ...]
    findings: tuple[str, ...]  # what will hurt, worst first


def examine(mesh: Mesh, articulation: Articulation, same: ModelSymmetries, unit_m: float | None) -> Examination:
    """``unit_m``: metres in a unit of the model, where that is known."""
    groups, area = surface_groups(mesh), face_areas(mesh)
    share = area / max(float(area.sum()), 1e-300)
    shares = tuple(float(v) for v in np.bincount(groups, weights=share))
    found = [
        *_of_size(mesh, share, unit_m),
        *_of_parts(mesh, articulation, share),
        *_of_surfaces(shares),
        *_of_faces(share),
        *mesh.warnings,
        *same.warnings,
    ]
    told = [str(one["kind"]) for one in describe_symmetries(same.symmetries, articulation)]
    return Examination(groups, shares, mesh.size, tuple(told), tuple(found))


def _of_size(mesh: Mesh, share: NDArray[np.float64], unit_m: float | None) -> list[str]:
    found, extent = [], max(mesh.size)
    low, high = SPACECRAFT_M
    if unit_m is not None and not low <= extent * unit_m <= high:
        found.append(f"it would be {extent * unit_m:.3g} m large: is a unit of the model {unit_m:g} m?")
    middles = np.vstack([part.vertices for part in mesh.parts])[mesh.faces].mean(axis=1)
    away = np.linalg.norm(middles - share @ middles, axis=1)
    order = np.argsort(away)
    usual = float(away[order][min(int(np.searchsorted(np.cumsum(share[order]), _NEARLY_ALL)), len(away) - 1)])
    if away.max() > _FAR * usual:
        far = mesh.parts[int(mesh.part_of[order[-1]])].name
        found.append(f"something small of {far!r} lies {away.max() / usual:.1f} times as far out as all else")
    return found


def _of_parts(mesh: Mesh, articulation: Articulation, share: NDArray[np.float64]) -> list[str]:
    moved = {part for joint in articulation.joints for stage in joint.stages for part in stage.parts}
    still = [k for k, part in enumerate(mesh.parts) if part.name not in moved and _is_panel(mesh, k, share)]
    if still and len(mesh.parts) > 1:
        names = ", ".join(mesh.parts[k].name for k in still)
        return [f"no joint moves {names}: if it turns in orbit, declare it"]
    if not articulation.joints and len(mesh.parts) == 1:
        return ["one part and no joint: panels that turn in orbit stay as they are drawn"]
    return []


def _is_panel(mesh: Mesh, k: int, share: NDArray[np.float64]) -> bool:
    vertices = mesh.parts[k].vertices
    extent = np.linalg.svd(vertices - vertices.mean(axis=0), compute_uv=False)
    return bool(extent[2] < _THIN * extent[0] and share[mesh.part_of == k].sum() > _LARGE)


def _of_surfaces(shares: Sequence[float]) -> list[str]:
    if max(shares) <= _ONE_SURFACE:
        return []
    return [f"{max(shares):.0%} of the surface is one piece: paint that changes on it is told as misfit"]


def _of_faces(share: NDArray[np.float64]) -> list[str]:
    tiny = float(np.mean(share < _TINY))
    return [f"{tiny:.0%} of the faces are smaller than any picture shows: they cost time"] if tiny > _MANY_TINY else []

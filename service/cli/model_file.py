"""A model for the offline commands: a mesh file with its joints, or the bundled satellite."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import typer

from gpu.mesh import Mesh, MeshError, load_mesh
from gpu.urdf_archive import pack_urdf
from service.errors import InputError
from service.inference.articulation import Articulation
from service.models.articulations import read_joints
from service.remote.urdf_files import mesh_files
from service.simulate.satellite import NAME, demo_satellite


@dataclass(frozen=True)
class ModelFile:
    """A file's bytes, and what is in it."""

    name: str  # with its suffix
    data: bytes
    file_type: str
    mesh: Mesh
    articulation: Articulation


def read_model_file(source: str, joints: tuple[Mapping[str, Any], ...] | None = None) -> ModelFile:
    """``demo``, or the path of a mesh file. Raises ``typer.BadParameter`` for one that cannot be used."""
    name, data = (f"{NAME}.glb", demo_satellite()) if source == NAME else _read(Path(source))
    file_type = Path(name).suffix.lower().removeprefix(".")
    try:
        mesh = load_mesh(data, file_type)
        found = read_joints(data, file_type, mesh, joints)
    except (MeshError, InputError) as error:
        raise typer.BadParameter(f"{name}: {error}") from error
    return ModelFile(name, data, file_type, mesh, found.articulation)


def read_joint_list(text: str | None) -> tuple[Mapping[str, Any], ...] | None:
    """The ``joints`` array of an upload: JSON, or the path of a JSON file."""
    if text is None:
        return None
    try:
        value = json.loads(text if text.lstrip().startswith("[") else Path(text).read_text())
    except (OSError, ValueError) as error:
        raise typer.BadParameter(f"--joints is neither JSON nor a JSON file: {error}") from error
    if not isinstance(value, list):
        raise typer.BadParameter("--joints must be a JSON array")
    return tuple(value)


def _read(path: Path) -> tuple[str, bytes]:
    try:
        data = path.read_bytes()
        meshes = mesh_files(path) if path.suffix.lower() == ".urdf" else []
        return path.name, pack_urdf(data, {file.name: file.read_bytes() for file in meshes})
    except OSError as error:
        raise typer.BadParameter(f"{path}: {error.strerror}") from error

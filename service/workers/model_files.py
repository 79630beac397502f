"""A model's files as the one file that is stored and handed to workers."""

from __future__ import annotations

from collections.abc import Mapping

from gpu.urdf_archive import pack_urdf
from service.errors import InputError


def pack_model(data: bytes, file_type: str, meshes: Mapping[str, bytes]) -> bytes:
    """The file itself, or a URDF document with its ``meshes`` by name. Raises ``InputError`` for meshes of others."""
    if not meshes:
        return data
    if file_type != "urdf":
        raise InputError("only a URDF file comes with meshes", field="meshes")
    return pack_urdf(data, meshes)

"""A URDF document with its mesh files as one file.

A robot whose shapes are all boxes, cylinders and spheres is plain XML. One with mesh files is kept as a ZIP archive
of ``robot.urdf`` and ``meshes/NAME``, never compressed: nothing in it is larger than it looks.
"""

from __future__ import annotations

import io
import zipfile
from collections.abc import Mapping

from gpu.mesh_limits import MeshError

DOCUMENT, MESHES = "robot.urdf", "meshes/"
_EPOCH = (1980, 1, 1, 0, 0, 0)  # of every file in the archive: the same content is the same bytes


def pack_urdf(document: bytes, meshes: Mapping[str, bytes]) -> bytes:
    """A document and its mesh files, by their names, as one file."""
    if not meshes:
        return document
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_STORED) as archive:
        for name, body in [(DOCUMENT, document), *((MESHES + name, meshes[name]) for name in sorted(meshes))]:
            archive.writestr(zipfile.ZipInfo(name, _EPOCH), body)
    return buffer.getvalue()


def unpack_urdf(data: bytes) -> tuple[bytes, dict[str, bytes]]:
    """Document and mesh files of ``pack_urdf``. Raises ``MeshError``."""
    if not data.startswith(b"PK"):
        return data, {}
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            entries = archive.infolist()
            if any(entry.compress_type != zipfile.ZIP_STORED or entry.file_size > len(data) for entry in entries):
                raise MeshError("URDF: the archive is compressed")
            files = {entry.filename: archive.read(entry) for entry in entries}
    except MeshError:
        raise
    except (zipfile.BadZipFile, NotImplementedError, RuntimeError, EOFError, ValueError, OSError) as error:
        raise MeshError(f"URDF: the archive cannot be read: {error}") from error
    document = files.pop(DOCUMENT, b"")
    return document, {name.removeprefix(MESHES): body for name, body in files.items()}

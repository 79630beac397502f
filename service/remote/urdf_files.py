"""The mesh files that a URDF document on disk names."""

from __future__ import annotations

import re
from pathlib import Path, PurePosixPath

_FILE = re.compile(r"""<mesh\b[^>]*\bfilename\s*=\s*["']([^"']+)["']""")


def mesh_files(document: Path) -> list[Path]:
    """Those that are found: where the document says, or in ``meshes`` beside it or beside its folder.

    One that is not found is left out; whoever reads the model says which it misses.
    """
    names = dict.fromkeys(_FILE.findall(document.read_text(encoding="utf-8", errors="replace")))
    found = (_find(document.parent, name) for name in names)
    return list(dict.fromkeys(path for path in found if path is not None))


def _find(folder: Path, name: str) -> Path | None:
    relative = PurePosixPath(re.sub(r"^(package://[^/]*/|file://)", "", name.replace("\\", "/")))
    places = (
        folder / relative,
        folder.parent / relative,
        *(f / "meshes" / relative.name for f in (folder, folder.parent)),
    )
    return next((place for place in (*places, folder / relative.name) if place.is_file()), None)

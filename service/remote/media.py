"""Media types of the files that the service reads, by their names."""

from __future__ import annotations

import re
from collections.abc import Iterable
from pathlib import Path, PurePath

IMAGES = {
    ".png": "image/png",
    ".jpg": "image/jpeg",
    ".jpeg": "image/jpeg",
    ".tif": "image/tiff",
    ".tiff": "image/tiff",
    ".fits": "image/fits",
    ".fit": "image/fits",
    ".fts": "image/fits",
    ".fz": "image/fits",
    ".npy": "application/x-npy",
}
VIDEOS = {
    ".ser": "video/x-ser",
    ".avi": "video/x-msvideo",
    ".mp4": "video/mp4",
    ".mkv": "video/x-matroska",
    ".mov": "video/quicktime",
}
MEDIA_TYPES = {**IMAGES, **VIDEOS}


def media_type_of(name: str) -> str | None:
    """Media type of a file by its name, None for one that the service does not read. ``x.fits.gz`` is FITS."""
    path = PurePath(name.lower())
    if path.suffix == ".gz":
        path = path.with_suffix("")
        return MEDIA_TYPES.get(path.suffix) if path.suffix in (".fits", ".fit", ".fts") else None
    return MEDIA_TYPES.get(path.suffix)


def in_order(paths: Iterable[Path]) -> list[Path]:
    """By their names, numbers in them by their size: ``frame_2.png`` is before ``frame_10.png``."""

    def key(path: Path) -> list[tuple[int, str]]:
        return [(int(part), "") if part.isdecimal() else (-1, part) for part in re.split(r"(\d+)", path.name)]

    return sorted(paths, key=key)


def frames_in(folder: Path) -> list[Path]:
    """Images and videos of a folder, in order. Raises ``FileNotFoundError`` where there is none."""
    found = in_order(path for path in folder.iterdir() if path.is_file() and media_type_of(path.name) is not None)
    if not found:
        raise FileNotFoundError(f"no image or video in {folder}")
    return found

"""Images on disk for the offline commands: a folder of image files, or a video."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import cv2
import typer

MEDIA_TYPES = {
    ".png": "image/png",
    ".jpg": "image/jpeg",
    ".jpeg": "image/jpeg",
    ".tif": "image/tiff",
    ".tiff": "image/tiff",
    ".fits": "image/fits",
    ".fit": "image/fits",
    ".fts": "image/fits",
    ".npy": "application/x-npy",
}


@dataclass(frozen=True)
class ImageFile:
    """One image as it would be posted."""

    name: str
    body: bytes
    media_type: str


@dataclass(frozen=True)
class ImageSource:
    """A folder's images in the order of their names, or a video's frames."""

    path: Path
    files: tuple[Path, ...]  # none for a video
    count: int | None  # None where a video does not say
    interval_s: float | None  # a video's

    def __iter__(self) -> Iterator[ImageFile]:
        if self.files:
            for path in self.files:
                yield ImageFile(path.name, path.read_bytes(), MEDIA_TYPES[path.suffix.lower()])
        else:
            yield from _video_frames(self.path)


def open_images(path: Path) -> ImageSource:
    """A folder or a video file. Raises ``typer.BadParameter`` where there is nothing to read."""
    if path.is_dir():
        files = tuple(sorted(p for p in path.iterdir() if p.suffix.lower() in MEDIA_TYPES))
        if not files:
            raise typer.BadParameter(f"{path} holds no image ({', '.join(MEDIA_TYPES)})")
        return ImageSource(path, files, len(files), None)
    if path.suffix.lower() in MEDIA_TYPES:
        return ImageSource(path, (path,), 1, None)
    capture = cv2.VideoCapture(str(path))
    try:
        if not path.exists() or not capture.isOpened():
            raise typer.BadParameter(f"{path} is no folder of images and no video that OpenCV can read")
        rate, count = capture.get(cv2.CAP_PROP_FPS), int(capture.get(cv2.CAP_PROP_FRAME_COUNT))
    finally:
        capture.release()
    return ImageSource(path, (), count if count > 0 else None, 1.0 / rate if rate > 0 else None)


def _video_frames(path: Path) -> Iterator[ImageFile]:
    capture = cv2.VideoCapture(str(path))
    try:
        k = 0
        while True:
            found, image = capture.read()
            if not found:
                return
            # Stored without loss and quickly: the image goes the same way as one that was posted.
            data = cv2.imencode(".png", image, [cv2.IMWRITE_PNG_COMPRESSION, 1])[1]
            yield ImageFile(f"{path.name}#{k}", data.tobytes(), "image/png")
            k += 1
    finally:
        capture.release()

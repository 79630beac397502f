"""Images on disk for the offline commands: a folder of image files, one file of one or many frames, or a video."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import cv2
import typer

from service.imaging.split import PNG, frame_count, split_frames
from service.remote.media import IMAGES, in_order, media_type_of

ONE_FRAME = ("image/png", "image/jpeg")

SER = ".ser"


@dataclass(frozen=True)
class ImageFile:
    """One image, or a file of several, as it would be posted."""

    name: str
    body: bytes
    media_type: str
    several: bool = False


@dataclass(frozen=True)
class ImageSource:
    """A folder's images in the order of their names (``remote.media.in_order``), or a video's frames."""

    path: Path
    files: tuple[Path, ...]  # none for a video
    count: int | None  # None where it is known only after reading
    interval_s: float | None  # a video's

    def __iter__(self) -> Iterator[ImageFile]:
        if self.files:
            for path in self.files:
                yield from _file_frames(path)
        else:
            yield from _video_frames(self.path)

    def files_to_post(self) -> Iterator[ImageFile]:
        """Files as they are, since their headers tell time and pointing; a video frame by frame, however long."""
        for path in self.files:
            body, kind = _read(path)
            yield ImageFile(path.name, body, kind, kind not in ONE_FRAME and frame_count(body, kind) != 1)
        if not self.files:
            yield from _video_frames(self.path)


def open_images(path: Path) -> ImageSource:
    """A folder or a video file. Raises ``typer.BadParameter`` where there is nothing to read."""
    if path.is_dir():
        files = tuple(in_order(p for p in path.iterdir() if _holds_images(p)))
        if not files:
            raise typer.BadParameter(f"{path} holds no image ({', '.join((*IMAGES, SER))})")
        single = all(media_type_of(p.name) in ONE_FRAME for p in files)
        return ImageSource(path, files, len(files) if single else None, None)
    if path.is_file() and _holds_images(path):
        return ImageSource(path, (path,), None, None)
    capture = cv2.VideoCapture(str(path))
    try:
        if not path.exists() or not capture.isOpened():
            raise typer.BadParameter(f"{path} is no folder of images and no video that OpenCV can read")
        rate, count = capture.get(cv2.CAP_PROP_FPS), int(capture.get(cv2.CAP_PROP_FRAME_COUNT))
    finally:
        capture.release()
    return ImageSource(path, (), count if count > 0 else None, 1.0 / rate if rate > 0 else None)


def _holds_images(path: Path) -> bool:
    """Whether a file is read here: all but videos, which OpenCV decodes frame by frame."""
    kind = media_type_of(path.name)
    return kind is not None and (path.suffix.lower() == SER or not kind.startswith("video/"))


def _file_frames(path: Path) -> Iterator[ImageFile]:
    """A file as it is, or each of its frames where it holds several. Raises ``ImageError``."""
    body, kind = _read(path)
    if kind in ONE_FRAME or frame_count(body, kind) == 1:
        yield ImageFile(path.name, body, kind)
        return
    for k, frame in enumerate(split_frames(body, kind)):
        yield ImageFile(f"{path.name}#{k}", frame.body, PNG)


def _read(path: Path) -> tuple[bytes, str]:
    kind = media_type_of(path.name)
    assert kind is not None, "chosen by its media type"
    return path.read_bytes(), kind


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

"""AVI, MP4 and what else OpenCV's FFmpeg reads. Video has no calendar time: its frames bring none."""

from __future__ import annotations

import os
import threading
from collections.abc import Iterator, Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from service.imaging.frame import Frame, as_frame
from service.imaging.headers import broken
from service.imaging.limits import ImageLimits

_MATROSKA = b"\x1a\x45\xdf\xa3"
_OPTIONS = "OPENCV_FFMPEG_CAPTURE_OPTIONS"  # of the process: how OpenCV hands FFmpeg a handle instead of a path
_OPENING = threading.Lock()


def read_video(body: bytes, limits: ImageLimits) -> Sequence[Frame]:
    """Every frame; grey where all frames have three equal channels. Raises ``ImageError``, ``TooLargeError``.

    What the container states of its length is not trusted: frames are counted as they come. Only containers that hold
    their own data are let through: FFmpeg would follow a playlist to other files and hosts.
    """
    if not (body[:4] == b"RIFF" and body[8:12] == b"AVI ") and body[4:8] != b"ftyp" and body[:4] != _MATROSKA:
        raise broken("the media type says video, but the body is neither AVI nor MP4 nor Matroska")
    # In memory: a decoder that is ended in the middle leaves no file behind.
    with os.fdopen(os.memfd_create("video"), "wb") as file:
        file.write(body)
        file.seek(0)
        images = list(_images(file.fileno(), limits))
    if not images:
        raise broken("the video has no frame that can be decoded")
    grey = all(np.array_equal(image[:, :, 0], image[:, :, k]) for image in images for k in (1, 2))
    return [as_frame(image[:, :, 0] if grey else image[:, :, ::-1]) for image in images]


def _images(handle: int, limits: ImageLimits) -> Iterator[NDArray[np.uint8]]:
    with _OPENING:
        os.environ[_OPTIONS] = f"fd;{handle}"  # FFmpeg's protocol "fd": where no file may be opened it works too
        capture = cv2.VideoCapture("fd:", cv2.CAP_FFMPEG, [cv2.CAP_PROP_N_THREADS, 1])
    try:
        width, height = (int(capture.get(name)) for name in (cv2.CAP_PROP_FRAME_WIDTH, cv2.CAP_PROP_FRAME_HEIGHT))
        if not capture.isOpened():
            raise broken("the video cannot be opened: its container or codec is unknown, or it is damaged")
        count = 0
        while capture.grab():
            count += 1
            limits.require_size(count, width, height)
            found, image = capture.retrieve()
            if not found or image.ndim != 3 or image.dtype != np.uint8:
                raise broken(f"frame {count - 1} of the video cannot be decoded")
            yield np.asarray(image, dtype=np.uint8)
    finally:
        capture.release()

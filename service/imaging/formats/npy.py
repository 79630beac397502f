"""NumPy's NPY: (H, W), (H, W, 3), (N, H, W) or (N, H, W, 3) numbers. A last axis of three is colour."""

from __future__ import annotations

import io
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from service.imaging.frame import Frame, as_frame
from service.imaging.headers import broken
from service.imaging.limits import ImageLimits


@dataclass(frozen=True)
class _Layout:
    frames: int
    height: int
    width: int
    colour: bool
    dtype: np.dtype[Any]
    fortran: bool
    start: int
    shape: tuple[int, ...]


def read_npy(body: bytes, limits: ImageLimits) -> Sequence[Frame]:
    """Every frame. Raises ``ImageError`` (also for arrays of objects), ``TooLargeError``."""
    layout = _read_layout(body)
    limits.require_size(layout.frames, layout.width, layout.height)
    size = layout.dtype.itemsize * int(np.prod(layout.shape, dtype=np.int64))
    data = body[layout.start : layout.start + size]
    if len(data) < size:
        raise broken("NPY: the file is cut short")
    array = np.frombuffer(data, layout.dtype).reshape(layout.shape, order="F" if layout.fortran else "C")
    colour = (3,) if layout.colour else ()
    return [as_frame(image) for image in array.reshape(layout.frames, layout.height, layout.width, *colour)]


def count_npy_frames(body: bytes) -> int:
    """Frames that the header states. Raises ``ImageError``."""
    return _read_layout(body).frames


def _read_layout(body: bytes) -> _Layout:
    stream = io.BytesIO(body)
    try:
        version = np.lib.format.read_magic(stream)
        read = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
        shape, fortran, dtype = read(stream)
    except Exception as error:  # a parser of Python literals: whatever it trips over, the file is at fault
        raise broken(f"NPY: the header cannot be read: {error}") from error
    if dtype.hasobject or dtype.kind not in "biuf":
        raise broken(f"NPY: {dtype} is no type of number")
    colour = len(shape) in (3, 4) and shape[-1] == 3
    axes = len(shape) - colour
    if axes not in (2, 3):
        raise broken(f"NPY: an array of shape {shape} is neither an image nor a sequence of images")
    height, width = shape[-3:-1] if colour else shape[-2:]
    return _Layout(shape[0] if axes == 3 else 1, height, width, colour, dtype, fortran, stream.tell(), shape)

"""NumPy's NPY: (H, W), (H, W, 3), (N, H, W) or (N, H, W, 3) numbers. A last axis of three is colour."""

from __future__ import annotations

import io
from collections.abc import Sequence

import numpy as np

from service.imaging.frame import Frame, as_frame, require_size
from service.imaging.headers import broken


def read_npy(body: bytes, max_pixels: int) -> Sequence[Frame]:
    """Every frame. Raises ``ImageError`` (also for arrays of objects), ``TooLargeError``."""
    stream = io.BytesIO(body)
    try:
        version = np.lib.format.read_magic(stream)
        read = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
        shape, fortran, dtype = read(stream)
    except ValueError as error:
        raise broken(f"NPY: {error}") from error
    if dtype.hasobject or dtype.kind not in "biuf":
        raise broken(f"NPY: {dtype} is no type of number")
    colour = len(shape) in (3, 4) and shape[-1] == 3
    plane = shape[-3:-1] if colour else shape[-2:]
    if len(shape) - 2 - colour not in (0, 1):
        raise broken(f"NPY: an array of shape {shape} is neither an image nor a sequence of images")
    frames = shape[0] if len(shape) - 2 - colour else 1
    require_size(frames, plane[1], plane[0], max_pixels)
    size = dtype.itemsize * int(np.prod(shape, dtype=np.int64))
    data = body[stream.tell() : stream.tell() + size]
    if len(data) < size:
        raise broken("NPY: the file is cut short")
    array = np.frombuffer(data, dtype).reshape(shape, order="F" if fortran else "C")
    return [as_frame(image) for image in array.reshape(frames, *plane, *((3,) if colour else ()))]

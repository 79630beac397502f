"""ASCOM Alpaca ImageBytes (``application/imagebytes``, metadata version 1).

Eleven little-endian 32-bit integers, then the pixels. The array's first index is x, its second y, its third the
colour plane, and the last index changes fastest: pixels come column by column.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence

import numpy as np

from service.imaging.frame import Frame, as_frame
from service.imaging.headers import broken
from service.imaging.limits import ImageLimits

_HEADER = struct.Struct("<11i")
# format: ASCOM Alpaca ImageBytes, types of elements
_TYPES = {
    1: "<i2",
    2: "<i4",
    3: "<f8",
    4: "<f4",
    5: "<u8",
    6: "<u1",
    7: "<i8",
    8: "<u2",
    9: "<u4",
}


def read_imagebytes(body: bytes, limits: ImageLimits) -> Sequence[Frame]:
    """The image. Raises ``ImageError`` (also for a device's error message in its place), ``TooLargeError``.

    The type on the wire decides: a camera whose 16-bit pixels travel as 32-bit integers gives 16 bits as well.
    """
    if len(body) < _HEADER.size:
        raise broken("ImageBytes: the file is shorter than its header")
    version, error, _, _, start, _, kind, rank, width, height, planes = _HEADER.unpack_from(body)
    if version != 1:
        raise broken(f"ImageBytes: metadata version {version}; this release reads 1")
    if error != 0:
        message = body[max(start, 0) :].decode("utf-8", "replace")[:200]
        raise broken(f"ImageBytes: the camera reports error {error}: {message}")
    if kind not in _TYPES or rank not in (2, 3) or (rank == 3 and planes not in (1, 3)) or start < _HEADER.size:
        raise broken(f"ImageBytes: elements of type {kind} in {rank} dimensions with {planes} planes are unknown")
    limits.require_size(1, width, height)
    shape = (width, height) if rank == 2 else (width, height, planes)
    dtype = np.dtype(_TYPES[kind])
    data = body[start : start + dtype.itemsize * int(np.prod(shape, dtype=np.int64))]
    if len(data) < dtype.itemsize * int(np.prod(shape, dtype=np.int64)):
        raise broken("ImageBytes: the file is cut short")
    return [as_frame(np.frombuffer(data, dtype).reshape(shape).swapaxes(0, 1))]

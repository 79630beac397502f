"""NPY and ASCOM ImageBytes."""

import io
import struct

import numpy as np
import pytest

from service.errors import ImageError, TooLargeError
from service.imaging.decode import ImageLimits, decode_frame, decode_frames

NPY, IMAGEBYTES = "application/x-npy", "application/imagebytes"
NOISE = np.random.default_rng(6)


def npy(array) -> bytes:
    stream = io.BytesIO()
    np.save(stream, array)
    return stream.getvalue()


@pytest.mark.parametrize("dtype", ["u1", "<u2", ">u2"])
@pytest.mark.parametrize("order", ["C", "F"])
@pytest.mark.parametrize(("shape", "frames"), [((9, 7), 1), ((9, 7, 3), 1), ((4, 9, 7), 4), ((4, 9, 7, 3), 4)])
def test_npy_of_any_layout(dtype, order, shape, frames):
    array = NOISE.integers(0, 256, shape).astype(dtype, order=order)
    found = decode_frames(npy(array), NPY)
    assert len(found) == frames
    np.testing.assert_array_equal(np.stack([frame.image for frame in found]).reshape(shape), array)
    assert found[0].image.dtype.isnative and found[0].channels == (3 if shape[-1] == 3 else 1)


@pytest.mark.parametrize(
    "array", [np.array([None]), np.zeros(5), np.zeros((2, 2, 2, 2)), np.zeros((0, 5)), np.array(["a"])]
)
def test_other_arrays_are_refused(array):
    stream = io.BytesIO()
    np.save(stream, array, allow_pickle=True)
    with pytest.raises(ImageError):
        decode_frame(stream.getvalue(), NPY)


def test_npy_is_measured_before_it_is_read():
    body = npy(np.zeros((10, 10), np.uint8))
    with pytest.raises(ImageError, match="cut short"):
        decode_frame(body[:-1], NPY)
    with pytest.raises(TooLargeError):
        decode_frame(body, NPY, limits=ImageLimits(pixels=99))
    with pytest.raises(ImageError):
        decode_frame(b"not numpy", NPY)


def imagebytes(array, kind: int, *, version=1, error=0, start=44) -> bytes:
    """``array`` is indexed [x, y] or [x, y, plane], as the standard has it."""
    planes = array.shape[2] if array.ndim == 3 else 0
    header = struct.pack("<11i", version, error, 1, 2, start, 2, kind, array.ndim, *array.shape[:2], planes)
    return header + bytes(start - 44) + np.ascontiguousarray(array).tobytes()


@pytest.mark.parametrize(
    ("kind", "dtype"), [(6, "u1"), (8, "<u2"), (1, "<i2"), (2, "<i4"), (9, "<u4"), (4, "<f4"), (3, "<f8")]
)
def test_imagebytes_come_column_by_column(kind, dtype):
    image = NOISE.integers(2, 120, (5, 8)).astype(dtype)
    frame = decode_frame(imagebytes(image.T, kind), IMAGEBYTES)
    np.testing.assert_array_equal(frame.image, image)
    assert frame.bits == (8 if kind == 6 else 16)
    colour = NOISE.integers(2, 120, (5, 8, 3)).astype(dtype)
    frame = decode_frame(imagebytes(colour.swapaxes(0, 1), kind, start=64), IMAGEBYTES)
    np.testing.assert_array_equal(frame.image, colour)


def test_broken_imagebytes_are_refused():
    image = np.ones((6, 4), np.uint16)
    for body in (
        imagebytes(image, 8)[:-1],
        imagebytes(image, 8)[:40],
        imagebytes(image, 8, version=2),
        imagebytes(image, 77),
        imagebytes(image, 8)[:32] + struct.pack("<3i", -6, -4, 0) + bytes(48),
        b"",
    ):
        with pytest.raises(ImageError):
            decode_frame(body, IMAGEBYTES)
    report = struct.pack("<11i", 1, 1035, 1, 2, 44, 0, 0, 0, 0, 0, 0) + b"no exposure yet"
    with pytest.raises(ImageError, match="1035: no exposure yet"):
        decode_frame(report, IMAGEBYTES)

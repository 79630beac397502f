"""Images: pixels come back as they went in, and nothing broken gets through."""

import struct
import zlib

import cv2
import numpy as np
import pytest

from service.errors import ImageError, TooLargeError, UnsupportedMediaTypeError
from service.imaging.decode import decode_frame, decode_frames
from service.imaging.headers import read_header


def encoded(image: np.ndarray, extension: str, *options: int) -> bytes:
    ok, data = cv2.imencode(extension, image, list(options))
    assert ok
    return data.tobytes()


def noise(shape, dtype=np.uint8) -> np.ndarray:
    return np.random.default_rng(1).integers(0, np.iinfo(dtype).max, shape, dtype=dtype, endpoint=True)


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
@pytest.mark.parametrize(("extension", "media"), [(".png", "image/png"), (".tiff", "image/tiff")])
def test_grey_and_colour_come_back_exactly(dtype, extension, media):
    grey, colour = noise((13, 17), dtype), noise((13, 17, 3), dtype)
    frame = decode_frame(encoded(grey, extension), media)
    np.testing.assert_array_equal(frame.image, grey)
    assert (frame.bits, frame.channels) == (np.dtype(dtype).itemsize * 8, 1)
    frame = decode_frame(encoded(colour[:, :, ::-1], extension), f"{media}; charset=binary")
    np.testing.assert_array_equal(frame.image, colour)
    assert frame.channels == 3
    assert frame.image.flags.c_contiguous


def test_alpha_is_dropped():
    rgba = noise((9, 8, 4))
    frame = decode_frame(encoded(rgba, ".png"), "image/png")
    np.testing.assert_array_equal(frame.image, rgba[:, :, 2::-1])


def test_grey_with_alpha_stays_grey():
    grey = noise((4, 5))
    rows = b"".join(b"\0" + np.stack([row, np.full(5, 200, np.uint8)], 1).tobytes() for row in grey)
    frame = decode_frame(png(5, 4, 8, 4, zlib.compress(rows)), "image/png")
    np.testing.assert_array_equal(frame.image, grey)


def test_jpeg_is_nearly_what_it_was():
    smooth = cv2.GaussianBlur(noise((64, 48)), (0, 0), 5)
    frame = decode_frame(encoded(smooth, ".jpg", cv2.IMWRITE_JPEG_QUALITY, 95), "image/jpeg")
    assert frame.channels == 1
    assert np.abs(frame.image.astype(int) - smooth).max() < 8


def test_every_page_of_a_tiff_is_read():
    pages = [noise((6, 7), np.uint16), noise((6, 7), np.uint16)[::-1].copy()]
    ok, data = cv2.imencodemulti(".tiff", pages)
    assert ok
    body = data.tobytes()
    frames = decode_frames(body, "image/tiff")
    for frame, page in zip(frames, pages, strict=True):
        np.testing.assert_array_equal(frame.image, page)
    with pytest.raises(ImageError, match="holds 2 frames"):
        decode_frame(body, "image/tiff")


def png(width: int, height: int, bits: int, colour: int, data: bytes) -> bytes:
    def chunk(name: bytes, payload: bytes) -> bytes:
        checksum = zlib.crc32(name + payload)
        return struct.pack(">I", len(payload)) + name + payload + struct.pack(">I", checksum)

    header = struct.pack(">IIBBBBB", width, height, bits, colour, 0, 0, 0)
    chunks = chunk(b"IHDR", header) + chunk(b"IDAT", data) + chunk(b"IEND", b"")
    return b"\x89PNG\r\n\x1a\n" + chunks


MEDIA = {".png": "image/png", ".jpg": "image/jpeg", ".tiff": "image/tiff"}


@pytest.mark.parametrize("extension", MEDIA)
@pytest.mark.parametrize("share", [0.0, 0.001, 0.01, 0.3, 0.9, 0.999])
def test_a_file_cut_short_is_refused(extension, share):
    body = encoded(noise((40, 50)), extension)
    with pytest.raises(ImageError) as caught:
        decode_frame(body[: int(share * len(body))], MEDIA[extension])
    assert caught.value.field == "body"


def test_a_damaged_png_is_refused():
    body = bytearray(encoded(noise((40, 50)), ".png"))
    body[len(body) // 2] ^= 0x10
    with pytest.raises(ImageError, match="CRC"):
        decode_frame(bytes(body), "image/png")


def test_a_png_with_too_few_rows_is_refused():
    rows = zlib.compress(b"\0" + bytes(50))
    with pytest.raises(ImageError):
        decode_frame(png(50, 40, 8, 0, rows), "image/png")


def test_limits_hold_before_decoding():
    body = png(30_000, 30_000, 8, 0, zlib.compress(b""))
    with pytest.raises(TooLargeError) as caught:
        decode_frame(body, "image/png")
    assert caught.value.facts["found"] == 900_000_000


@pytest.mark.parametrize("media", ["text/plain", "", "application/octet-stream", "image/gif"])
def test_other_media_types_are_refused_with_those_there_are(media):
    with pytest.raises(UnsupportedMediaTypeError) as caught:
        decode_frame(encoded(noise((4, 4)), ".png"), media)
    assert {"image/jpeg", "image/png", "image/tiff", "image/fits"} <= set(caught.value.facts["supported"])


@pytest.mark.parametrize("media", ["image/jpeg", "image/tiff", "image/png"])
def test_a_body_of_another_type_is_refused(media):
    other = ".png" if media != "image/png" else ".jpg"
    with pytest.raises(ImageError, match="media type says"):
        decode_frame(encoded(noise((4, 4)), other), media)


def test_float_tiff_is_refused():
    with pytest.raises(ImageError, match="TIFF"):
        decode_frame(encoded(np.ones((4, 4), np.float32), ".tiff"), "image/tiff")


def test_headers_say_what_is_inside():
    assert read_header(encoded(noise((3, 5, 3), np.uint16), ".png"), "image/png").bits == 16
    header = read_header(encoded(noise((3, 5, 3)), ".jpg"), "image/jpg")
    assert (header.width, header.height, header.channels) == (5, 3, 3)

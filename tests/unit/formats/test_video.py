"""SER, whose flag of byte order lies, and what OpenCV reads."""

import struct
from datetime import UTC, datetime, timedelta

import cv2
import numpy as np
import pytest

from service.errors import ImageError, TooLargeError
from service.imaging.decode import ImageLimits, decode_frame, decode_frames, read_facts

SER = "video/x-ser"
START = datetime(2026, 11, 20, 3, 4, 5, 250_000, tzinfo=UTC)


def smooth(frames=3, height=30, width=40, most=4095) -> np.ndarray:
    noise = np.random.default_rng(7).random((frames, height, width)).astype(np.float32)
    blurred = np.stack([cv2.GaussianBlur(image, (0, 0), 3) for image in noise])
    return ((blurred - blurred.min()) / np.ptp(blurred) * most).astype(np.uint16)


def ser(stack, *, colour=0, depth=16, flag=0, big=False, times=True) -> bytes:
    n, height, width = stack.shape[:3]
    header = struct.pack(
        "<14s7i40s40s40s2q", b"LUCAM-RECORDER", 0, colour, flag, width, height, depth, n, b"", b"", b"", 0, 0
    )
    pixels = stack.astype("u1" if depth <= 8 else ">u2" if big else "<u2").tobytes()
    ticks = [
        (START + timedelta(seconds=k) - datetime(1, 1, 1, tzinfo=UTC)) // timedelta(microseconds=1) * 10
        for k in range(n)
    ]
    return header + pixels + (struct.pack(f"<{n}q", *ticks) if times else b"")


@pytest.mark.parametrize("depth", [12, 16])
@pytest.mark.parametrize("flag", [0, 1])
@pytest.mark.parametrize("big", [False, True])
def test_the_pixels_decide_the_byte_order(depth, flag, big):
    stack = smooth(most=4095 if depth == 12 else 60_000)
    body = ser(stack, depth=depth, flag=flag, big=big)
    for order in ("auto", "big" if big else "little"):
        frames = decode_frames(body, SER, ser_byte_order=order)
        np.testing.assert_array_equal([frame.image for frame in frames], stack)


def test_a_noisy_dark_frame_has_its_order_too():
    """Read noise on a pedestal: neighbours resemble each other in their high bytes only."""
    dark = np.random.default_rng(8).normal(1000, 30, (2, 30, 40)).astype(np.uint16)
    for big in (False, True):
        frames = decode_frames(ser(dark, big=big), SER)
        np.testing.assert_array_equal([frame.image for frame in frames], dark)


def test_times_are_those_of_the_trailer():
    body = ser(smooth())
    assert [frame.facts.time for frame in decode_frames(body, SER)] == [START + timedelta(seconds=k) for k in range(3)]
    assert read_facts(body, SER).time == START
    assert read_facts(ser(smooth(), times=False), SER).time is None


def test_eight_bits_colours_and_bayer():
    grey = smooth(most=255)
    frame = decode_frame(ser(grey[:1], depth=8), SER)
    np.testing.assert_array_equal(frame.image, grey[0])
    assert frame.bits == 8
    colour = np.random.default_rng(9).integers(0, 256, (1, 10, 12, 3))
    np.testing.assert_array_equal(decode_frame(ser(colour, colour=100, depth=8), SER).image, colour[0])
    np.testing.assert_array_equal(decode_frame(ser(colour, colour=101, depth=8), SER).image, colour[0, :, :, ::-1])
    mosaic = np.zeros((1, 8, 8), np.uint16)
    mosaic[0, ::2, ::2] = 1000  # only the red pixels of RGGB are lit
    seen = decode_frame(ser(mosaic, colour=8), SER).image
    assert seen.shape == (8, 8, 3) and seen[4, 4, 0] == 1000 and seen[..., 1:].max() == 0


def test_broken_ser_is_refused():
    body = ser(smooth(), times=False)
    for bad in (body[:-1], body[:100], b"X" + body[1:], body[:18] + struct.pack("<i", 16) + body[22:], b""):
        with pytest.raises(ImageError):
            decode_frames(bad, SER)
    with pytest.raises(TooLargeError):
        decode_frames(body, SER, limits=ImageLimits(pixels=100))


def encoded(tmp_path, name: str, codec: str, images, colour: bool) -> bytes:
    path = tmp_path / name
    height, width = images[0].shape[:2]
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*codec), 25, (width, height), colour)
    assert writer.isOpened()
    for image in images:
        writer.write(image)
    writer.release()
    return path.read_bytes()


@pytest.mark.parametrize(
    ("name", "codec", "media"), [("a.avi", "FFV1", "video/x-msvideo"), ("a.mp4", "mp4v", "video/mp4")]
)
def test_video_as_opencv_writes_it(tmp_path, name, codec, media):
    images = [
        np.ascontiguousarray(np.repeat(image[:, :, None], 3, axis=2))
        for image in smooth(4, 48, 64, 255).astype(np.uint8)
    ]
    images = [image * np.array([1, 1, 0], np.uint8) for image in images]  # blue and green
    frames = decode_frames(encoded(tmp_path, name, codec, images, True), media)
    assert len(frames) == 4 and frames[0].channels == 3
    difference = np.abs(np.stack([f.image for f in frames]).astype(int) - np.stack(images)[..., ::-1])
    assert np.median(difference) <= 3


def test_a_grey_video_is_grey(tmp_path):
    images = list(smooth(2, 48, 64, 255).astype(np.uint8))
    frames = decode_frames(encoded(tmp_path, "g.avi", "FFV1", images, False), "video/avi")
    assert [frame.channels for frame in frames] == [1, 1]
    np.testing.assert_allclose(frames[1].image, images[1], atol=2)


def test_what_is_no_video_is_refused(tmp_path):
    body = encoded(tmp_path, "a.avi", "FFV1", [np.zeros((48, 64, 3), np.uint8)] * 3, True)
    playlist = b"#EXTM3U\n#EXTINF:1,\nhttp://127.0.0.1:9/secret\n"
    for bad in (b"junk" * 20, playlist, body[:60], b"RIFF\0\0\0\0AVI " + b"x" * 100):
        with pytest.raises(ImageError):
            decode_frames(bad, "video/avi")
    with pytest.raises(TooLargeError):
        decode_frames(body, "video/avi", limits=ImageLimits(pixels=48 * 64 * 2))
    with pytest.raises(ImageError, match="3 frames"):
        decode_frame(body, "video/avi")

"""Overlay and contact sheet: what is covered is blue, what is not is left alone."""

import cv2
import numpy as np
import pytest

from service.imaging.contact_sheet import SheetRow, contact_sheet, shown_indices
from service.imaging.overlay import BLUE, draw_overlay, draw_silhouette, encode_png, for_display


def disc(shape=(40, 50)) -> np.ndarray:
    y, x = np.mgrid[: shape[0], : shape[1]]
    return np.hypot(x - 25, y - 20) < 10


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
@pytest.mark.parametrize("channels", [(), (3,)])
def test_the_silhouette_is_blue_and_the_rest_is_the_frame(dtype, channels):
    image = np.random.default_rng(0).integers(0, 200, (40, 50, *channels)).astype(dtype)
    mask = disc()
    drawn = draw_overlay(image, mask)
    assert drawn.shape == (40, 50, 3)
    assert drawn.dtype == np.uint8
    np.testing.assert_array_equal(drawn[~mask], for_display(image)[~mask])
    assert tuple(drawn[20, 16]) == BLUE  # on the outline
    assert drawn[mask][:, 2].mean() > drawn[mask][:, 0].mean() + 30


def test_sixteen_bits_are_stretched_but_noise_alone_stays_dark():
    noise = np.random.default_rng(0).normal(340, 6, (64, 64)).astype(np.uint16)
    assert for_display(noise).max() < 80
    noise[20:30, 20:30] = 2000
    assert for_display(noise)[25, 25, 0] > 250


def test_eight_bit_colour_is_shown_as_it_is():
    image = np.random.default_rng(0).integers(0, 255, (4, 5, 3)).astype(np.uint8)
    np.testing.assert_array_equal(for_display(image), image)


def test_png_keeps_the_order_of_colours():
    picture = np.zeros((4, 5, 3), np.uint8)
    picture[..., 0] = 200
    read = cv2.imdecode(np.frombuffer(encode_png(picture), np.uint8), cv2.IMREAD_COLOR_RGB)
    np.testing.assert_array_equal(read, picture)


def test_a_mask_at_the_border_has_an_outline_there():
    drawn = draw_overlay(np.zeros((6, 6), np.uint8), np.ones((6, 6), bool))
    assert tuple(drawn[0, 3]) == BLUE
    assert tuple(drawn[3, 3]) != BLUE


def test_the_papers_frames_or_the_last():
    assert shown_indices(200) == [0, 4, 9, 99]
    assert shown_indices(40) == [0, 4, 9, 39]
    assert shown_indices(7) == [0, 4, 6]
    assert shown_indices(1) == [0]
    assert shown_indices(0) == []


def test_a_sheet_has_three_pictures_a_row():
    image = np.full((128, 128), 90, np.uint8)
    mask = disc((128, 128))
    sheet = contact_sheet("a pass", [SheetRow("frame 1\nIoU 0.9", image, mask)] * 2)
    left = sheet.shape[1] - 3 * (256 + 6)
    silhouette = sheet[42 : 42 + 256, left + 262 : left + 262 + 256]
    np.testing.assert_array_equal(silhouette[::2, ::2], draw_silhouette(mask))
    assert sheet.shape[0] == 42 + 2 * (256 + 6)

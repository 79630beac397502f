"""How loud a frame's noise is beside that of the empty ones: gain, exposure and moonlight change it during a pass."""

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter
from test_patch import SHAPE, noise, sky, with_box

from service.imaging.noise import checkerboard, from_pixel_to_pixel, louder, loudness
from service.imaging.patch import light_of


def test_the_noise_of_a_frame_is_its_own_where_it_is_another_than_that_of_the_empty_ones():
    for times in (2.5, 0.4):
        image = np.round(100 + 5 * times * noise() + with_box(40, 30, 80, 60, 200.0)).astype(np.uint16)
        assert light_of(image, sky([5.0]), 16).sigma == pytest.approx(5 * times, rel=0.06)


def test_as_long_as_that_may_be_chance_it_is_that_of_the_empty_ones():
    for seed in range(40):
        image = np.round(100 + 5 * noise(seed)).astype(np.uint16)
        assert light_of(image, sky([5.0]), 16).sigma == pytest.approx(5.0, rel=1e-6)


def test_photons_of_the_body_are_no_noise_of_the_sky():
    """Nor is a paint that changes from pixel to pixel."""
    body = with_box(30, 10, 130, 110, 2000.0) * (1 + 0.1 * noise(3))
    image = np.round(100 + 5 * noise() + body).astype(np.uint16)
    assert light_of(image, sky([5.0]), 16).sigma == pytest.approx(5.0, rel=1e-6)


def test_noise_from_pixel_to_pixel_is_the_whole_of_white_noise_and_little_of_smooth():
    white = np.stack([3 * noise(seed) for seed in range(3)]).astype(np.float32)
    smooth = np.stack([gaussian_filter(one, 2.0) for one in white])
    everywhere = np.ones(SHAPE, bool)
    told = [from_pixel_to_pixel(one[..., None], everywhere, np.array([[float(one.var())]])) for one in (white, smooth)]
    assert told[0] == pytest.approx(1.0, abs=0.03) and told[1] < 0.1
    assert loudness(checkerboard(white[0])) == pytest.approx(3.0, rel=0.05)


def test_a_program_that_leaves_no_noise_leaves_nothing_to_tell_it_by():
    assert louder(3.0, 0.2, 4000) == 1.0
    assert louder(3.0, 1.0, 4000) == 3.0
    assert louder(1.05, 1.0, 4000) == 1.0
    assert louder(0.0, 1.0, 0) == 1.0

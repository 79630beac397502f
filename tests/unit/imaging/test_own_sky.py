"""The sky is learned from a frame that shows the object."""

import numpy as np
import pytest

from service.imaging.background import learn
from service.imaging.features import feature_spec
from service.imaging.own_sky import own_sky
from service.imaging.sky import derive

SIDE = 120


def sky(bits: int, side: int = SIDE) -> np.ndarray:
    across, down = np.meshgrid(np.linspace(-1, 1, side), np.linspace(-1, 1, side))
    level = 30 + 6 * across - 4 * down + 5 * (across**2 + down**2)
    return level * (1 if bits == 8 else 200)


def frame(bits: int, channels: int, seed: int = 0, side: int = SIDE) -> tuple[np.ndarray, np.ndarray]:
    """A body with a soft rim, some stars; and what is truly sky."""
    x, y = np.meshgrid(*2 * [np.arange(side) * SIDE / side])
    away = np.hypot((x - 70) / 1.6, y - 55)
    body = 120 / (1 + np.exp(away - 18)) * (1 if bits == 8 else 200)
    image = sky(bits, side)[..., None] * np.linspace(1, 0.8, channels) + body[..., None]
    rng = np.random.default_rng(seed)
    image += rng.normal(0, 2.0 if bits == 8 else 300.0, image.shape)
    for row, column in rng.integers(0, side, (6, 2)):
        image[row : row + 2, column : column + 2] += 60 if bits == 8 else 9000
    image = np.clip(np.rint(image), 0, (1 << bits) - 1).astype(np.uint8 if bits == 8 else np.uint16)
    return (image[..., 0] if channels == 1 else image), away < 18


@pytest.mark.parametrize(("bits", "channels"), [(8, 1), (16, 1), (8, 3)])
def test_the_body_is_left_out_and_the_sky_behind_it_is_told(bits, channels):
    image, body = frame(bits, channels)
    filled, known = own_sky(image, bits)
    assert filled.shape == image.shape and filled.dtype == image.dtype
    assert not known[body].any() and known.mean() > 0.4
    spec = feature_spec("auto", channels, bits, 1.0)
    found = derive(learn(None, filled, bits, spec, known), "auto", 1.0)
    true = sky(bits)[..., None] * np.linspace(1, 0.8, channels)
    noise = 2.0 if bits == 8 else 300.0
    assert np.abs(found.mean - true)[body].max() < 0.75 * noise
    assert found.sigma == pytest.approx(noise, rel=0.1)


def test_a_large_frame_is_told_from_a_part_of_its_pixels():
    image, body = frame(16, 1, side=1000)
    filled, known = own_sky(image, 16)
    assert not known[body].any() and known.mean() > 0.4
    assert np.abs(filled - sky(16, 1000))[body].max() < 0.75 * 300


def test_an_exactly_black_sky_is_known():
    image, body = frame(8, 1)
    image = np.where(image > 90, image, 0).astype(np.uint8)
    filled, known = own_sky(image, 8)
    assert not filled.any() and not known[body & (image > 0)].any() and known.mean() > 0.5


def test_a_body_that_is_everywhere_leaves_the_border():
    image = np.full((SIDE, SIDE), 30, np.uint8)
    image[8:-8, 8:-8] = 200
    filled, known = own_sky(image, 8)
    assert known.any() and not known[10:-10, 10:-10].any()
    assert np.abs(filled.astype(int) - 30).max() <= 1


def test_haze_is_sky_and_no_light():
    image, body = frame(8, 1)
    x, y = np.meshgrid(np.arange(SIDE), np.arange(SIDE))
    hazy = np.clip(image + 4.0 * np.sin(x / 19.0) * np.cos(y / 23.0), 0, 255).astype(np.uint8)
    _, known = own_sky(hazy, 8)
    assert not known[body].any() and known.mean() > 0.4

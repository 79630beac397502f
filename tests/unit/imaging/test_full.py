"""Where a sensor is full below what its file holds: counts pile up there, and light is noisy elsewhere."""

import cv2
import numpy as np
import pytest

from service.imaging.full import upper_end

SIDE, SKY, MOST = 96, 20.0, 255


def frame(sigma: float, light: float, seed: int = 0, channels: int = 1) -> np.ndarray:
    """(H, W, C) a body that is brighter in its middle, blurred, in noise."""
    body = np.zeros((SIDE, SIDE), np.float32)
    body[30:60, 24:70], body[40:52, 34:60] = 0.4 * light, light
    noise = np.random.default_rng(seed).normal(0.0, sigma, (SIDE, SIDE, channels))
    return np.rint(SKY + cv2.GaussianBlur(body, (0, 0), 1.5)[..., None] + noise).astype(np.float32)


def told(image: np.ndarray, sigma: float, step: int = 1, most: int = MOST) -> list[float]:
    mean = np.full(image.shape, SKY, np.float32)
    return upper_end(image, mean, np.full(image.shape[2], sigma), step, most).tolist()


@pytest.mark.parametrize("seed", range(8))
@pytest.mark.parametrize("sigma", [0.5, 1.0, 2.0, 8.0])
def test_light_that_is_noisy_is_no_full_sensor(sigma, seed):
    assert told(frame(sigma, 120.0, seed), sigma) == [MOST]


@pytest.mark.parametrize("sigma", [1.0, 2.0, 8.0])
def test_counts_that_pile_up_are_where_the_sensor_is_full(sigma):
    assert told(np.minimum(frame(sigma, 120.0), 100.0), sigma) == [100.0]


def test_each_channel_is_full_at_its_own_count():
    image = np.minimum(frame(2.0, 120.0, channels=3), [90.0, 300.0, 110.0]).astype(np.float32)
    assert told(image, 2.0) == [90.0, MOST, 110.0]


def test_a_file_that_is_full_is_full_there_alone():
    image = np.minimum(frame(2.0, 300.0), MOST)
    assert (image == MOST).sum() > 100
    assert told(image, 2.0) == [MOST]


@pytest.mark.parametrize("light", [0.0, 5.0])
def test_an_even_sky_is_no_full_sensor(light):
    image = np.minimum(frame(2.0, light), SKY + 6.0)
    assert told(image, 2.0) == [MOST]


@pytest.mark.parametrize("light", [120.0, 160.0])
def test_where_counts_lie_further_apart_than_noise_nothing_is_told(light):
    """Posterised, or stretched: then many a pixel is as bright as the brightest."""
    steps = 32 * np.rint(frame(2.0, light) / 32)
    assert told(steps, 2.0) == [MOST]
    table = np.rint((np.arange(256) / 255.0) ** (1 / 0.45) * 65535).astype(np.float32)
    image = table[np.clip(frame(2.0, light), 0, 255).astype(int)]
    assert told(image, float(table[22] - table[20]), most=65535) == [65535]


def test_twelve_bits_in_sixteen_are_told_in_their_steps():
    image = 16 * np.minimum(frame(4.0, 4000.0), 3000.0)
    assert told(image, 64.0, step=16, most=65535) == [48000.0]
    assert told(16 * frame(4.0, 2000.0), 64.0, step=16, most=65535) == [65535]

"""The point spread as a mixture of Gaussians: against its transfer function, and what it does to a drawing."""

import cv2
import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from service.inference.model.spread import (
    MIXTURE_WEIGHTS,
    PointSpread,
    band,
    deviations,
    gradient,
    spread,
)

SIDE = 256
SPREADS = [(1.2, 0.0), (1.2, 0.8), (1.0, 2.0), (1.5, 4.0)]


SHARPENED = [(0.0, 0.0), (1.5, 2.0)]


def transfer(core: float, wings: float, k: np.ndarray, sharpened: float = 0.0, mask: float = 0.0) -> np.ndarray:
    """Of docs/model.md, section 2; k in radians per px."""
    unsharp = 1 + sharpened * (1 - np.exp(-0.5 * (k * mask) ** 2))
    return unsharp * np.exp(-0.5 * (k * core) ** 2 - (k * wings) ** (5 / 3))


@pytest.mark.parametrize(("core", "wings"), SPREADS)
@pytest.mark.parametrize("low_pass", [0.0, 1.0])
@pytest.mark.parametrize("mask", SHARPENED)
def test_a_point_has_the_transfer_function(core, wings, low_pass, mask):
    point = np.zeros((1, SIDE, SIDE), np.float32)
    point[0, SIDE // 2, SIDE // 2] = 1.0
    found = np.abs(np.fft.fft2(spread(point, PointSpread(core, wings, *mask), low_pass)[0]))
    line = 2 * np.pi * np.abs(np.fft.fftfreq(SIDE))
    k = np.hypot(line[:, None], line[None])
    wanted = transfer(np.hypot(core, low_pass), wings, k, *mask)
    assert PointSpread(core, wings, *mask).transfer(k) == pytest.approx(transfer(core, wings, k, *mask))
    believed = k * wings < 4.0
    assert np.abs(found - wanted)[believed & (k < 2.5)].max() < 0.006 * (1 + mask[0])


def test_a_picture_sharpened_with_opencv_is_what_the_point_spread_makes_of_it():
    body = np.zeros((1, SIDE, SIDE), np.float32)
    body[0, 100:150, 90:170] = 100.0
    seen = spread(body, PointSpread(1.2), 0.0)[0]
    wanted = seen + 1.5 * (seen - cv2.GaussianBlur(seen, (0, 0), 2.0))
    assert spread(body, PointSpread(1.2, 0.0, 1.5, 2.0), 0.0)[0] == pytest.approx(wanted, abs=0.5)
    assert wanted.min() < -15


@pytest.mark.parametrize(("core", "wings"), SPREADS)
def test_light_is_kept(core, wings):
    images = np.zeros((3, SIDE, SIDE), np.float32)
    images[:, 110:140, 120:135] = np.random.default_rng(0).uniform(0, 9, (3, 30, 15))
    found = spread(images, PointSpread(core, wings), 0.7)
    assert found.shape == images.shape and found.dtype == np.float32
    assert found.sum(axis=(1, 2)) == pytest.approx(images.sum(axis=(1, 2)), rel=1e-4)
    assert (found >= 0).all()
    assert sum(MIXTURE_WEIGHTS) == pytest.approx(1.0, abs=1e-9)


def test_light_that_leaves_the_patch_is_gone_and_none_comes_in():
    image = np.ones((1, 64, 64), np.float32)
    found = spread(image, PointSpread(2.0), 0.0)[0]
    assert found[32, 32] == pytest.approx(1.0, abs=1e-5)
    assert 0.5 < found[0, 32] < 0.65
    assert 0.25 < found[0, 0] < 0.4


@pytest.mark.parametrize("sigma", [0.6, 1.0, 2.5, 6.0])
def test_a_band_is_a_gaussian_blur(sigma):
    matrix = band(48, sigma)
    image = np.random.default_rng(1).uniform(0, 1, (48, 48))
    wanted = gaussian_filter(image, sigma, mode="constant", truncate=8.0)
    assert matrix @ image @ matrix == pytest.approx(wanted, abs=1e-5)
    assert np.array_equal(matrix, matrix.T)
    assert not matrix.flags.writeable and band(48, sigma) is matrix


def test_a_band_of_no_width_changes_nothing():
    assert np.array_equal(band(20, 0.0), np.eye(20))


def test_a_band_holds_no_numbers_that_are_slow():
    """Below the least normal float32 a product takes tens of times as long."""
    for sigma in (0.5, 1.0, 3.0):
        matrix = band(112, sigma)
        assert matrix[matrix > 0].min() > 1e-15


def test_two_blurs_are_one_of_their_widths_together():
    inside = slice(24, 40)
    both = band(64, 1.5) @ band(64, 2.0)
    assert both[inside] == pytest.approx(band(64, 2.5)[inside], abs=2e-4)


def test_the_width_grows_with_core_and_wings():
    assert PointSpread(1.3).width == pytest.approx(1.3)
    widths = [PointSpread(1.3, wings).width for wings in (0.0, 0.5, 1.0, 2.0)]
    assert widths == sorted(set(widths))
    assert PointSpread(2.6, 2.0).width == pytest.approx(2 * PointSpread(1.3, 1.0).width)


@pytest.mark.parametrize("share", [0.0, 0.3, 0.95])
def test_a_width_and_the_wings_share_of_it_are_a_point_spread(share):
    found = PointSpread.of(1.7, share)
    assert found.width == pytest.approx(1.7) and found.share == pytest.approx(share)


def test_slopes_are_differences_and_none_at_the_border():
    across, down = np.meshgrid(np.arange(12.0), np.arange(12.0))
    dx, dy = gradient((3 * across - 2 * down + across**2).astype(np.float32)[None])
    assert dx[0, :, 1:-1] == pytest.approx(np.tile(3 + 2 * np.arange(1.0, 11.0), (12, 1)))
    assert dy[0, 1:-1] == pytest.approx(-2.0)
    assert not dx[0, :, [0, -1]].any() and not dy[0, [0, -1]].any()


def test_deviations_turn_a_gaussian_into_its_hermite_functions():
    """Of a spot as wide as the point spread: x^2 - 1 over the root of two, in units of its height, and so on."""
    side, width = 96, 6.0
    at = (np.arange(side) + 0.5 - side / 2) / width
    spot = np.exp(-0.5 * (at[:, None] ** 2 + at[None] ** 2)).astype(np.float32)
    found = deviations(spot, width)
    x, y = at[None], at[:, None]
    assert len(found) == 12
    assert found[0] == pytest.approx((x**2 - 1) / np.sqrt(2) * spot, abs=0.03)  # order 2, along x
    assert found[1] == pytest.approx(x * y * spot, abs=0.03)
    assert found[2] == pytest.approx((y**2 - 1) / np.sqrt(2) * spot, abs=0.03)
    assert found[3] == pytest.approx(-(x**3 - 3 * x) / np.sqrt(6) * spot, abs=0.05)
    assert found[11] == pytest.approx((y**4 - 6 * y**2 + 3) / np.sqrt(24) * spot, abs=0.06)
    assert np.abs(found.sum(axis=(1, 2))).max() < 1e-2 * spot.sum()

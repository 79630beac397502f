"""Histogram bins of every feature, by hand."""

import numpy as np
import pytest

from service.imaging.features import FeatureSpec, feature_bins, feature_spec, gradient_magnitude, grey


@pytest.mark.parametrize(
    ("name", "channels", "bits", "expected"),
    [
        ("auto", 1, 8, FeatureSpec("intensity", 256, 8)),
        ("auto", 1, 16, FeatureSpec("intensity", 65536, 16)),
        ("auto", 3, 8, FeatureSpec("colour", 32**3, 8)),
        ("colour", 1, 8, FeatureSpec("intensity", 256, 8)),
        ("intensity", 3, 16, FeatureSpec("intensity", 65536, 16)),
        ("gradient", 3, 8, FeatureSpec("gradient", 1024, 8, 2.5)),
    ],
)
def test_auto_takes_colour_where_there_is_colour(name, channels, bits, expected):
    assert feature_spec(name, channels, bits, 2.5) == expected


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_intensity_is_the_level_itself(dtype):
    image = np.array([[0, 1], [200, np.iinfo(dtype).max]], dtype=dtype)
    spec = feature_spec("intensity", 1, np.dtype(dtype).itemsize * 8, 1.0)
    np.testing.assert_array_equal(feature_bins(image, spec), image)
    np.testing.assert_array_equal(feature_bins(image[..., None], spec), image)


def test_grey_is_the_rounded_mean_of_the_channels():
    image = np.array([[[10, 20, 31], [255, 255, 255]]], dtype=np.uint8)
    np.testing.assert_array_equal(grey(image), [[20, 255]])
    assert grey(image).dtype == np.uint8


@pytest.mark.parametrize(("dtype", "shift"), [(np.uint8, 0), (np.uint16, 8)])
def test_colour_is_one_joint_histogram(dtype, shift):
    """32 levels a channel: (255, 128, 7) -> (31, 16, 0) -> 31 * 1024 + 16 * 32 + 0."""
    image = (np.array([[[255, 128, 7], [0, 8, 16]]]) << shift).astype(dtype)
    bins = feature_bins(image, feature_spec("colour", 3, 8 + shift, 1.0))
    np.testing.assert_array_equal(bins, [[31 * 1024 + 16 * 32, 32 + 2]])


def test_the_brightest_colour_is_in_the_last_bin():
    spec = feature_spec("colour", 3, 16, 1.0)
    assert feature_bins(np.full((1, 1, 3), 65535, np.uint16), spec).max() == spec.n_bins - 1


def test_the_gradient_of_a_ramp_is_its_slope():
    """Levels rise by 3 to the right and 4 downwards: magnitude 5, whatever the scale."""
    y, x = np.mgrid[0:41, 0:41]
    for sigma in (0.7, 1.0, 3.0):
        inner = gradient_magnitude((3 * x + 4 * y).astype(np.uint16), sigma)[15:26, 15:26]
        np.testing.assert_allclose(inner, 5, rtol=1e-4)


@pytest.mark.parametrize(("dtype", "bits"), [(np.uint8, 8), (np.uint16, 16)])
@pytest.mark.parametrize("sigma", [0.5, 1.0, 4.0])
def test_a_full_step_fills_the_gradient_range_and_stays_in_it(dtype, bits, sigma):
    image = np.zeros((60, 60), dtype)
    image[:, 30:] = np.iinfo(dtype).max
    bins = feature_bins(image, feature_spec("gradient", 1, bits, sigma))
    assert bins.min() == 0
    assert 500 < bins.max() < 1024
    flipped = feature_bins(image.T[::-1].copy(), feature_spec("gradient", 1, bits, sigma))
    assert flipped.max() == bins.max()


def test_gradient_of_colour_is_that_of_its_grey():
    rgb = np.random.default_rng(1).integers(0, 256, (20, 20, 3)).astype(np.uint8)
    spec = feature_spec("gradient", 3, 8, 1.0)
    np.testing.assert_array_equal(feature_bins(rgb, spec), feature_bins(grey(rgb), spec))

"""Distributions inside and around the object: learned outside of a box, followed frame by frame."""

import numpy as np
import pytest

from service.imaging.region import Region, first_region, learn_region, region_bins, region_log_ratio

SIZE = 80
LIMIT = 3.0


def scene(seed: int, *, sky=60, body=180, at=(40, 40), half=10, colour=False, noise=3.0) -> np.ndarray:
    """8-bit square of level ``body`` on ``sky``; levels are numbers or RGB triples."""
    rng = np.random.default_rng(seed)
    shape = (SIZE, SIZE, 3) if colour else (SIZE, SIZE)
    image = np.empty(shape)
    image[...] = sky
    image[square(at, half)] = body
    return np.clip(np.rint(image + noise * rng.standard_normal(shape)), 0, 255).astype(np.uint8)


def square(at=(40, 40), half=10) -> np.ndarray:
    y, x = np.mgrid[:SIZE, :SIZE]
    return (np.abs(x - at[0]) < half) & (np.abs(y - at[1]) < half)


OUTSIDE = ~square(half=20)  # what a user's box of 40 x 40 leaves as known


@pytest.mark.parametrize("colour", [False, True])
def test_the_map_tells_the_object_from_its_surroundings(colour):
    """The box holds three times as much background as object."""
    levels = {"sky": (40, 90, 160), "body": (150, 120, 60)} if colour else {}
    image = scene(1, colour=colour, **levels)
    region = first_region(image, 8, OUTSIDE)
    log_ratio = region_log_ratio(image, 8, region)
    assert log_ratio.dtype == np.float32
    assert log_ratio.shape == (SIZE, SIZE)
    assert np.mean(log_ratio[square(half=7)]) > 1.0
    assert np.mean(log_ratio[OUTSIDE]) < -0.3
    assert np.mean((log_ratio > 0) == square()) > 0.95
    assert np.abs(log_ratio).max() <= LIMIT


def test_both_distributions_sum_to_one_and_are_nowhere_zero():
    region = first_region(scene(1), 8, OUTSIDE)
    for histogram in (region.foreground, region.background):
        assert histogram.sum() == pytest.approx(1, abs=1e-5)
        assert histogram.min() > 0


def test_bins_by_hand():
    """64 levels of grey, 16 per channel of colour, of the sensor's range; a flat image is not changed by smoothing."""
    bins, levels = region_bins(np.full((9, 9), 130, np.uint8), 8)
    assert (levels, set(bins.ravel())) == (64, {130 // 4})
    bins, levels = region_bins(np.full((9, 9), 65535, np.uint16), 16)
    assert (levels, set(bins.ravel())) == (64, {63})
    image = np.empty((9, 9, 3), np.uint8)
    image[:] = (250, 17, 100)
    bins, levels = region_bins(image, 8)
    assert (levels, set(bins.ravel())) == (16, {15 * 256 + 1 * 16 + 6})


def test_the_same_scene_in_16_bits_gives_the_same_map():
    image = scene(2)
    wide = image.astype(np.uint16) * 256
    maps = [region_log_ratio(i, bits, first_region(i, bits, OUTSIDE)) for i, bits in ((image, 8), (wide, 16))]
    np.testing.assert_allclose(maps[0], maps[1], atol=1e-3)


def test_learning_follows_a_change_of_light():
    """The body fades from 180 to 120, the sky brightens from 60 to 90: followed, the map holds; left alone, not."""
    frozen = region = first_region(scene(1), 8, OUTSIDE)
    for k in range(30):
        image = scene(10 + k, body=180 - 2 * k, sky=60 + k)
        region = learn_region(region, image, 8, square())
    good, bad = (np.mean((region_log_ratio(image, 8, r) > 0) == square()) for r in (region, frozen))
    assert good > 0.97
    assert bad < 0.9
    assert region.foreground.sum() == pytest.approx(1, abs=1e-4)
    assert region.background.sum() == pytest.approx(1, abs=1e-4)


def test_one_frame_teaches_its_share():
    """The new foreground is 0.85 of the old and 0.15 of what the mask shows, away from its edge."""
    region = first_region(scene(1), 8, OUTSIDE)
    image = scene(3, body=222)
    learned = learn_region(region, image, 8, square())
    change = learned.foreground - 0.85 * region.foreground
    assert change.sum() == pytest.approx(0.15, abs=1e-4)
    assert change.min() > 0
    assert np.argmax(change) == 222 // 4
    assert change[180 // 4 - 2 : 180 // 4 + 3].sum() < 0.01


def test_light_at_the_edge_teaches_neither_side():
    """A rim two pixels wide about the mask, of a level of its own, is left out of both."""
    region = first_region(scene(1), 8, OUTSIDE)
    image = scene(3)
    image[square(half=12) & ~square()] = 250
    learned = learn_region(region, image, 8, square())
    level = slice(244 // 4, 64)
    assert learned.foreground[level].sum() < region.foreground[level].sum() + 0.01
    assert learned.background[level].sum() < region.background[level].sum() + 0.03


def test_far_surroundings_do_not_teach():
    """The ring about the object is what counts: a bright corner of the picture is not learned."""
    region = first_region(scene(1), 8, OUTSIDE)
    image = scene(3)
    image[:12, :12] = 240
    learned = learn_region(region, image, 8, square(half=6))
    assert learned.background[230 // 4 :].sum() <= region.background[230 // 4 :].sum() + 1e-4


def test_a_silhouette_of_a_few_pixels_teaches_nothing():
    region = first_region(scene(1), 8, OUTSIDE)
    mask = np.zeros((SIZE, SIZE), bool)
    assert learn_region(region, scene(2), 8, mask) is region
    mask[3, :15] = True
    assert learn_region(region, scene(2), 8, mask) is region


def test_a_silhouette_without_a_core_still_teaches():
    """A thin truss is all edge."""
    mask = np.zeros((SIZE, SIZE), bool)
    mask[30:32, 10:70] = True
    image = scene(2, body=60)
    image[27:35, 7:73] = 202
    region = first_region(scene(1), 8, OUTSIDE)
    learned = learn_region(region, image, 8, mask)
    assert np.argmax(learned.foreground - 0.85 * region.foreground) == 202 // 4


def test_a_silhouette_over_the_whole_picture_keeps_the_background():
    region = first_region(scene(1), 8, OUTSIDE)
    learned = learn_region(region, scene(2), 8, np.ones((SIZE, SIZE), bool))
    np.testing.assert_allclose(learned.background, region.background, rtol=1e-6)


def test_learning_leaves_the_old_distributions_alone():
    region = first_region(scene(1), 8, OUTSIDE)
    before = Region(region.foreground.copy(), region.background.copy())
    learn_region(region, scene(5, body=90), 8, square())
    np.testing.assert_array_equal(region.foreground, before.foreground)
    np.testing.assert_array_equal(region.background, before.background)


def test_a_box_over_nothing_but_background_favours_no_pixel_strongly():
    """Inside and outside alike: what is left to say is little."""
    image = scene(4, body=60)
    log_ratio = region_log_ratio(image, 8, first_region(image, 8, OUTSIDE))
    assert np.abs(np.mean(log_ratio)) < 0.5
    assert np.mean(log_ratio > 1.0) < 0.02

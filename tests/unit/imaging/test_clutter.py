"""A body in a box: what is clutter and what is sky about it, and what colours each has."""

import numpy as np
import pytest

from service.imaging.background import known_pixels, learn
from service.imaging.clutter import cluttered_box, features, palette_of, told_box
from service.imaging.features import feature_spec
from service.imaging.sky import derive

SIZE, BOX = 160, (50, 40, 60, 70)


def room(rng, channels=3):
    """Patches of five paints, and in the box a body that has colours of its own; and where it is."""
    paints = np.linspace(0, 130, 5)[:, None] * rng.uniform(0.6, 1, (5, channels))
    patches = paints[rng.integers(0, 5, (10, 10))].repeat(16, axis=0).repeat(16, axis=1)
    body = np.zeros((SIZE, SIZE), bool)
    body[48:104, 56:104] = True
    stripes = np.where(np.arange(SIZE)[:, None, None] % 6 < 3, 140.0, 220.0) * np.ones((SIZE, SIZE, channels))
    image = np.where(body[..., None], stripes, patches) + rng.normal(0, 2, patches.shape)
    return np.clip(image, 0, 255).astype(np.uint8).squeeze(), body


def night(rng):
    """Empty sky with stars, and a body in the box."""
    image = rng.normal(20, 3, (SIZE, SIZE)) + np.linspace(0, 10, SIZE)
    image[rng.integers(0, SIZE, 20), rng.integers(0, SIZE, 20)] += 100
    image[55:95, 60:100] += 80
    return np.clip(image, 0, 255).astype(np.uint8)


def outside(box=BOX, border=None):
    return known_pixels(SIZE, SIZE, box, border)


def test_a_box_is_told_from_a_margin_and_from_a_sky_that_was_found():
    assert told_box(outside()) == BOX
    assert told_box(outside((140, 150, 60, 70))) == (140, 150, 20, 10)
    assert told_box(outside(None, 10)) is None
    assert told_box(outside(None)) is None
    ragged = outside()
    ragged[60, 60] = True
    assert told_box(ragged) is None


@pytest.mark.parametrize("seed", range(3))
def test_clutter_is_what_is_as_loud_as_the_body(seed):
    rng = np.random.default_rng(seed)
    assert cluttered_box(night(rng), outside()) is None
    for channels in (1, 3):
        assert cluttered_box(room(rng, channels)[0], outside()) == BOX
        assert cluttered_box(room(rng, channels)[0], outside(None, 20)) is None


@pytest.mark.parametrize(("channels", "bits"), [(1, 8), (3, 8), (1, 16), (3, 16)])
def test_colours_tell_the_body_from_what_else_is_in_its_box(channels, bits):
    image, body = room(np.random.default_rng(5), channels)
    image = image if bits == 8 else (40 + 7 * image.astype(np.uint16))
    palette = palette_of(image, BOX)
    told = palette.log_ratio(features(image, palette.low, palette.span))
    box = ~outside()
    assert np.median(told[body]) > 1 > 0 > np.median(told[box & ~body])
    assert told.shape == (SIZE, SIZE) and np.abs(told).max() <= 3


def test_colours_are_learnt_from_an_outline():
    image, body = room(np.random.default_rng(6))
    before = palette_of(image, BOX)
    bins = features(image, before.low, before.span)
    after = before.learnt(bins, body.astype(np.float32), 0.0)
    told = after.log_ratio(bins)
    assert np.mean(told[body] > 0) > 0.97 and np.mean(told[~body] < 0) > 0.97
    assert np.array_equal(before.learnt(bins, body.astype(np.float32), 1.0).body, before.body)
    for density in (after.body, after.clutter):
        assert np.exp(density.astype(np.float64)).sum() == pytest.approx(1, abs=1e-4)


def test_a_sky_knows_its_clutter():
    rng = np.random.default_rng(7)
    for image, box in ((room(rng)[0], BOX), (night(rng), None)):
        spec = feature_spec("auto", 1 if image.ndim == 2 else 3, 8, 1.0)
        sky = derive(learn(None, image, 8, spec, outside()), "auto", 1.0)
        assert sky.clutter == box

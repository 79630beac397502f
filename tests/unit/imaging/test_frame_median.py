"""The median of a few frames by a sorting network."""

from itertools import product

import numpy as np
import pytest

from service.imaging import frame_median
from service.imaging.frame_median import exchanges, median_of


@pytest.mark.parametrize("count", range(1, 11))
def test_the_network_puts_any_values_in_order(count):
    """A network that sorts every row of zeros and ones sorts everything (Knuth, 5.3.4 Z)."""
    rows = np.array(list(product((0, 1), repeat=count))).T
    for low, high in exchanges(count):
        rows[[low, high]] = np.minimum(rows[low], rows[high]), np.maximum(rows[low], rows[high])
    assert (np.diff(rows, axis=0) >= 0).all()


@pytest.mark.parametrize("count", [1, 2, 3, 5, 8, 16])
def test_it_is_the_median_of_every_pixel(count, monkeypatch):
    monkeypatch.setattr(frame_median, "_NEAR_BYTES", 4 * count * 14 * 5)  # five rows at a time
    frames = np.random.default_rng(count).normal(0, 9, (count, 23, 7, 2)).astype(np.float32)
    before = frames.copy()
    np.testing.assert_array_equal(median_of(frames), np.median(frames, axis=0))
    np.testing.assert_array_equal(frames, before)

"""A region of interest and binning: which pixels, and what becomes of them."""

import numpy as np
import pytest

from service.errors import ConfigError
from service.imaging.frame import as_frame
from service.imaging.window import window_of


def test_a_window_is_cut_and_averaged_to_the_nearest_count():
    image = np.arange(7 * 9, dtype=np.uint8).reshape(7, 9)
    window = window_of(9, 7, (1, 2, 8, 5), 2)
    assert (window.size, window.width, window.height) == ((4, 2), 8, 4)
    cut = window.cut(as_frame(image)).image
    assert cut.dtype == np.uint8
    expected = [[image[2 + 2 * i : 4 + 2 * i, 1 + 2 * j : 3 + 2 * j].mean() for j in range(4)] for i in range(2)]
    np.testing.assert_array_equal(cut, np.rint(expected))
    colour = window.cut(as_frame(np.stack([image] * 3, axis=2))).image
    np.testing.assert_array_equal(colour[..., 1], cut)


def test_the_whole_frame_stays_as_it_is():
    frame = as_frame(np.zeros((5, 4), np.uint16))
    assert window_of(4, 5, None, 1).cut(frame).image is not None
    assert np.shares_memory(window_of(4, 5, None, 1).cut(frame).image, frame.image)


def test_a_binned_pixel_is_known_where_all_of_it_is():
    mask = np.ones((4, 4), bool)
    mask[0, 1] = False
    np.testing.assert_array_equal(window_of(4, 4, None, 2).cut_mask(mask), [[False, True], [True, True]])


@pytest.mark.parametrize(("roi", "binning"), [((0, 0, 11, 5), 1), ((6, 0, 5, 5), 1), ((0, 0, 3, 3), 4)])
def test_a_window_lies_in_the_frame(roi, binning):
    with pytest.raises(ConfigError):
        window_of(10, 10, roi, binning)

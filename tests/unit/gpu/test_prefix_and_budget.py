"""Fixed-point prefix sums and batches."""

import numpy as np
import pytest

from gpu.budget import batch_size, group_count
from gpu.errors import ScorerError
from gpu.prefix import fixed_point_prefix


def test_prefix_sums_are_exact_for_small_whole_numbers():
    maps = np.random.default_rng(0).integers(-100, 100, (3, 5, 40)).astype(np.float32)
    prefix, units = fixed_point_prefix(maps)
    assert prefix.shape == (3, 5, 41)
    assert np.array_equal(np.diff(prefix, axis=2) * units[:, None, None], maps)
    assert (prefix[:, :, 0] == 0).all()


@pytest.mark.parametrize("scale", [1e-30, 1e-3, 1.0, 3e30])
def test_prefix_sums_never_overflow_and_lose_little(scale):
    maps = np.full((1, 2, 999), scale, np.float32)
    prefix, units = fixed_point_prefix(maps)
    assert prefix[0, 0, -1] * units[0] == pytest.approx(999 * float(np.float32(scale)), rel=1e-5)
    assert prefix.max() <= 2**30


def test_an_empty_map_has_a_unit_too():
    prefix, units = fixed_point_prefix(np.zeros((1, 3, 3), np.float32))
    assert not prefix.any()
    assert np.isfinite(units).all()


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_a_map_must_be_finite(value):
    with pytest.raises(ScorerError, match="not finite"):
        fixed_point_prefix(np.full((1, 2, 2), value, np.float32))


def test_a_batch_fits_and_holds_at_least_one_particle():
    assert batch_size(1 << 40, 1 << 30, 1 << 28) == 1
    assert batch_size(100, 1 << 40, 1 << 40) * 100 <= 256 << 20
    assert batch_size(100, 1 << 30, 1000) == 10


def test_groups_are_fewer_where_their_memory_would_not_fit():
    assert group_count(10, 8, 1000, 1 << 40, 1 << 40) == 80
    assert group_count(10, 8, 1 << 20, 1 << 27, 1 << 27) == 16
    assert group_count(10, 8, 1 << 40, 1 << 27, 1 << 27) == 1

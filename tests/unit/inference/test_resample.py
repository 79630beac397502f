"""Resampling: Eq. 6 step by step, and what each scheme promises for every single draw."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from service.inference.resample import RESAMPLERS, multinomial, residual, stratified, systematic

examples = settings(max_examples=60)
log_weight = st.one_of(st.just(-np.inf), st.floats(-30, 0), st.floats(-1e5, 1e5))
log_weights_of_any_kind = st.lists(log_weight, min_size=1, max_size=12).filter(lambda v: max(v) > -np.inf)


class Fixed(np.random.Generator):
    """A generator whose uniform numbers are given."""

    def __init__(self, value: float) -> None:
        super().__init__(np.random.Philox(0))
        self._value = value

    def random(self, size=None):
        return self._value if size is None else np.full(size, self._value)


NEARLY_ONE = float(np.nextafter(1.0, 0.0))


def counts(ancestors: np.ndarray, n: int) -> np.ndarray:
    return np.bincount(ancestors, minlength=n)


def test_equation_6_is_its_three_steps():
    """(1) cumulative weights c_j, (2) a fresh uniform r per particle, (3) the smallest j with c_j >= r."""
    weights = np.array([0.125, 0.0, 0.5, 0.25, 0.125])
    cumulative = [0.125, 0.125, 0.625, 0.875, 1.0]
    with np.errstate(divide="ignore"):
        found = multinomial(np.random.Generator(np.random.Philox(11)), np.log(weights), 400)
    r = 1.0 - np.random.Generator(np.random.Philox(11)).random(400)
    expected = [next(j for j in range(5) if cumulative[j] >= r_i) for r_i in r]
    np.testing.assert_array_equal(found, expected)
    assert len(set(r)) == 400  # a fresh r each


@pytest.mark.parametrize(
    ("r", "ancestor"), [(2**-53, 1), (0.25, 1), (0.25 + 2**-53, 2), (0.75, 2), (0.76, 3), (1.0, 3)]
)
def test_equation_6_at_the_borders_of_a_step(r, ancestor):
    """Weights 0, 1/4, 1/2, 1/4, 0: c = 0, 0.25, 0.75, 1, 1."""
    with np.errstate(divide="ignore"):
        log_weights = np.log([0, 0.25, 0.5, 0.25, 0])
    np.testing.assert_array_equal(multinomial(Fixed(1.0 - r), log_weights, 3), [ancestor] * 3)


def test_systematic_by_hand():
    """Points (0.5 + i) / 4 = 0.125, 0.375, 0.625, 0.875 against c = 0.1, 0.4, 1.0."""
    np.testing.assert_array_equal(systematic(Fixed(0.5), np.log([0.1, 0.3, 0.6]), 4), [1, 1, 2, 2])


def test_residual_by_hand():
    """4 w = 2.4, 1.2, 0.4: two copies of the first, one of the second; the last draw by remainders 0.4, 0.2, 0.4."""
    log_weights = np.log([0.6, 0.3, 0.1])
    np.testing.assert_array_equal(residual(Fixed(1.0 - 0.3), log_weights, 4), [0, 0, 1, 0])
    np.testing.assert_array_equal(residual(Fixed(1.0 - 0.5), log_weights, 4), [0, 0, 1, 1])
    np.testing.assert_array_equal(residual(Fixed(1.0 - 0.7), log_weights, 4), [0, 0, 1, 2])


@pytest.mark.parametrize("name", RESAMPLERS)
@pytest.mark.parametrize("r", [0.0, 0.5, NEARLY_ONE])
@pytest.mark.parametrize("count", [1, 4, 1000, 100_003])
def test_no_extreme_draw_takes_a_particle_of_zero_weight(name, r, count):
    """Leading, inner and trailing -inf, with r at both ends of what a generator gives: (r + M - 1) / M rounds to 1."""
    log_weights = np.array([-np.inf, -np.inf, -1e5, -np.inf, -1e5 + 1, -np.inf])
    ancestors = RESAMPLERS[name](Fixed(r), log_weights, count)
    assert len(ancestors) == count
    assert set(ancestors) <= {2, 4}


@pytest.mark.parametrize("name", RESAMPLERS)
@given(values=log_weights_of_any_kind, seed=st.integers(0, 2**32), count=st.integers(1, 50))
@examples
def test_ancestors_are_particles_of_positive_weight(name, values, seed, count):
    log_weights = np.array(values)
    ancestors = RESAMPLERS[name](np.random.Generator(np.random.Philox(seed)), log_weights, count)
    assert ancestors.shape == (count,)
    assert np.issubdtype(ancestors.dtype, np.integer)
    weights = np.exp(log_weights - log_weights.max())
    assert np.all(weights[ancestors] > 0)


@pytest.mark.parametrize("name", RESAMPLERS)
def test_weights_need_not_be_normalised(name):
    log_weights = np.log(np.random.default_rng(3).random(30))
    one = RESAMPLERS[name](np.random.Generator(np.random.Philox(1)), log_weights, 64)
    other = RESAMPLERS[name](np.random.Generator(np.random.Philox(1)), log_weights + 2.0**16, 64)
    assert np.mean(one != other) < 0.05  # the same but for rounding at the borders


@given(values=st.lists(st.floats(-8, 0), min_size=1, max_size=40), seed=st.integers(0, 2**32))
@examples
def test_systematic_gives_floor_or_ceiling_of_the_expectation(values, seed):
    log_weights = np.array(values)
    expected = 100 * np.exp(log_weights) / np.exp(log_weights).sum()
    found = counts(systematic(np.random.Generator(np.random.Philox(seed)), log_weights, 100), len(values))
    assert np.all(found >= np.floor(expected + 1e-9) - (np.abs(expected - np.rint(expected)) < 1e-9))
    assert np.all(found <= np.ceil(expected - 1e-9) + (np.abs(expected - np.rint(expected)) < 1e-9))


@given(values=st.lists(st.floats(-8, 0), min_size=1, max_size=40), seed=st.integers(0, 2**32))
@examples
def test_stratified_is_within_two_of_the_expectation(values, seed):
    """A particle's stretch of [0, 1) covers whole strata and at most two in part, so fewer than two either way."""
    log_weights = np.array(values)
    expected = 100 * np.exp(log_weights) / np.exp(log_weights).sum()
    found = counts(stratified(np.random.Generator(np.random.Philox(seed)), log_weights, 100), len(values))
    assert np.all(np.abs(found - expected) < 2 + 1e-9)


@given(values=st.lists(st.floats(-8, 0), min_size=1, max_size=40), seed=st.integers(0, 2**32))
@examples
def test_residual_gives_at_least_the_floor(values, seed):
    log_weights = np.array(values)
    expected = 100 * np.exp(log_weights) / np.exp(log_weights).sum()
    found = counts(residual(np.random.Generator(np.random.Philox(seed)), log_weights, 100), len(values))
    assert np.all(found >= np.floor(expected - 1e-9))


@pytest.mark.parametrize("name", ["systematic", "stratified", "residual"])
def test_equal_weights_lose_nobody(name):
    ancestors = RESAMPLERS[name](np.random.Generator(np.random.Philox(1)), np.full(49, -1e5), 49)
    np.testing.assert_array_equal(np.sort(ancestors), np.arange(49))

"""Weights in the log domain, at the magnitudes that images of 10^5 pixels give."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from service.inference.weights import effective_sample_size, log_sum_exp, normalise

examples = settings(max_examples=100)
log_values = arrays(np.float64, st.integers(1, 40), elements=st.floats(-1e5, 1e5))


def test_log_sum_exp_by_hand():
    assert log_sum_exp(np.log([1.0, 2.0, 3.0])) == pytest.approx(np.log(6), abs=1e-15)
    assert log_sum_exp(np.array([-np.inf, 0.0])) == 0.0
    assert log_sum_exp(np.array([-np.inf, -np.inf])) == -np.inf


@pytest.mark.parametrize("offset", [1e5, -1e5, 1e9])
def test_log_sum_exp_at_any_magnitude(offset):
    assert log_sum_exp(offset + np.array([0.0, 0.0, -1000.0])) - offset == pytest.approx(np.log(2), abs=1e-6)


@examples
@given(log_values)
def test_normalised_weights_sum_to_one_and_keep_their_ratios(values):
    log_weights, total = normalise(values)
    assert np.exp(log_weights).sum() == pytest.approx(1, abs=1e-9)
    np.testing.assert_allclose(log_weights + total, values, atol=1e-9)
    assert values.max() - 1e-9 <= total <= values.max() + np.log(len(values)) + 1e-9


def test_normalise_by_hand():
    log_weights, total = normalise(np.array([-1e5, -1e5 + np.log(3), -np.inf]))
    np.testing.assert_allclose(np.exp(log_weights), [0.25, 0.75, 0], atol=1e-10)
    assert total == pytest.approx(-1e5 + np.log(4))


@pytest.mark.parametrize("values", [[-np.inf, -np.inf], [0.0, np.nan], [0.0, np.inf]])
def test_weights_that_cannot_be_normalised_are_an_error(values):
    with pytest.raises(FloatingPointError, match="sum to"):
        normalise(np.array(values))


def test_effective_sample_size_by_hand():
    assert effective_sample_size(np.log([0.5, 0.25, 0.25])) == pytest.approx(1 / (0.25 + 0.0625 + 0.0625))
    assert effective_sample_size(np.full(7, -1e5)) == pytest.approx(7)
    assert effective_sample_size(np.array([0.0, -1e5, -np.inf])) == pytest.approx(1)


@examples
@given(log_values)
def test_effective_sample_size_lies_between_one_and_n(values):
    assert 1 - 1e-9 <= effective_sample_size(values) <= len(values) * (1 + 1e-9)

"""Weights in the log domain, at the magnitudes that images of 10^5 pixels give."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from service.inference.weights import effective_sample_size, log_sum_exp, next_exponent, normalise

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


@pytest.mark.parametrize("magnitude", [1.0, 1e3, 1e5])
@pytest.mark.parametrize("target", [0.1, 0.5, 0.9])
@pytest.mark.parametrize("start", [0.0, 1e-7])
def test_next_exponent_hits_the_target(magnitude, target, start):
    rng = np.random.default_rng(5)
    n = 500
    log_likelihood = -magnitude * rng.random(n) ** 0.2 - magnitude
    uniform = np.full(n, -np.log(n))
    beta = next_exponent(uniform, log_likelihood, start, 1000.0, target)
    assert start < beta < 1000
    ess = effective_sample_size(uniform + (beta - start) * log_likelihood) / n
    assert ess == pytest.approx(target, abs=0.005)


def test_next_exponent_hits_the_target_from_uneven_weights():
    """The effective size counts the weights as they are, not only what the new step adds."""
    rng = np.random.default_rng(6)
    log_weights, _ = normalise(0.3 * rng.standard_normal(400))
    log_likelihood = 50 * rng.standard_normal(400)
    beta = next_exponent(log_weights, log_likelihood, 0.2, 1.0, 0.5)
    ess = effective_sample_size(log_weights + (beta - 0.2) * log_likelihood) / 400
    assert ess == pytest.approx(0.5, abs=0.005)


def test_next_exponent_ends_where_the_likelihood_is_gentle():
    log_likelihood = np.linspace(0, 0.1, 50)
    assert next_exponent(np.zeros(50), log_likelihood, 0.0, 0.7, 0.5) == 0.7
    assert next_exponent(np.zeros(50), log_likelihood, 0.7, 0.7, 0.5) == 0.7


def test_next_exponent_goes_on_even_when_the_weights_already_are_too_uneven():
    log_weights = np.log([0.97, 0.01, 0.01, 0.01])
    beta = next_exponent(log_weights, np.array([10.0, 0, 0, 0]), 0.25, 1.0, 0.5)
    assert 0.25 < beta < 0.3
    assert next_exponent(log_weights, np.array([10.0, 0, 0, 0]), 1 - 1e-9, 1.0, 0.5) == 1.0

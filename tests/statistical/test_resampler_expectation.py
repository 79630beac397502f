"""Every resampler draws particle j N w_j times on average: a chi-square test over many repetitions.

The bounds are honest: seeds are fixed, and a right implementation passes with probability 1 - 1e-5 for a seed
chosen at random.
"""

import numpy as np
import pytest
from scipy import stats

from service.inference.resample import RESAMPLERS

LEVEL = 1e-5
WEIGHTS = np.array([0.0, 0.31, 0.02, 0.0, 0.11, 0.003, 0.237, 0.2, 0.12, 0.0])
REPETITIONS = 3000


@pytest.mark.parametrize("name", RESAMPLERS)
@pytest.mark.parametrize("count", [7, 40])
def test_expected_counts_are_n_times_the_weights(name, count):
    with np.errstate(divide="ignore"):
        log_weights = np.log(WEIGHTS) - 1e4
    rng = np.random.Generator(np.random.Philox(20260))
    drawn = np.array([np.bincount(RESAMPLERS[name](rng, log_weights, count), minlength=10) for _ in range(REPETITIONS)])
    assert np.all(drawn.sum(axis=1) == count)
    positive = WEIGHTS > 0
    assert not drawn[:, ~positive].any()
    # Repetitions are independent, counts within one are not: the quadratic form in their empirical covariance
    # is chi-square. Counts add up to N and some schemes fix more, so the covariance is inverted on its range.
    deviation = drawn[:, positive].mean(axis=0) - count * WEIGHTS[positive]
    values, vectors = np.linalg.eigh(np.cov(drawn[:, positive].T) / REPETITIONS)
    varies = values > 1e-9 * values.max()
    coordinates = vectors.T @ deviation
    assert np.all(np.abs(coordinates[~varies]) < 1e-6)  # where nothing varies, the expectation is met exactly
    statistic = float(np.sum(coordinates[varies] ** 2 / values[varies]))
    assert statistic < stats.chi2.isf(LEVEL, int(varies.sum()))


def test_multinomial_draws_are_independent():
    """Eq. 6's counts have the multinomial covariance N (diag w - w w^T): a fresh r per particle, not one for all."""
    weights = np.array([0.5, 0.3, 0.2])
    rng = np.random.Generator(np.random.Philox(5))
    drawn = np.array(
        [np.bincount(RESAMPLERS["multinomial"](rng, np.log(weights), 20), minlength=3) for _ in range(4000)]
    )
    expected = 20 * (np.diag(weights) - np.outer(weights, weights))
    np.testing.assert_allclose(np.cov(drawn.T), expected, atol=5 * 5 * np.sqrt(2 / 4000))


@pytest.mark.parametrize("name", ["systematic", "stratified", "residual"])
def test_the_other_schemes_vary_less(name):
    weights = np.random.default_rng(1).dirichlet(np.ones(50))
    rng = np.random.Generator(np.random.Philox(6))

    def variance(scheme: str) -> float:
        drawn = [np.bincount(RESAMPLERS[scheme](rng, np.log(weights), 50), minlength=50) for _ in range(400)]
        return float(np.var(drawn, axis=0).sum())

    assert variance(name) < 0.8 * variance("multinomial")

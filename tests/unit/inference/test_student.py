"""The Student t of ``service.inference.numerics.student`` against SciPy's."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import multivariate_t

from service.inference.numerics.student import draw, log_density, root_of, squared_radius

SCALE = np.array([[2.0, 0.3, 0.0], [0.3, 1.0, -0.2], [0.0, -0.2, 0.5]])


def test_the_density_is_scipys():
    at = np.random.default_rng(1).normal(size=(20, 3)) * 3
    assert log_density(at, SCALE, 4.0) == pytest.approx(multivariate_t(np.zeros(3), SCALE, df=4.0).logpdf(at))


def test_draws_fill_the_regions():
    drawn = draw(np.random.default_rng(2), SCALE, 4.0, 100_000)
    square = np.sum(np.linalg.solve(np.linalg.cholesky(SCALE), drawn.T) ** 2, axis=0)
    for share in (0.5, 0.9, 0.99):
        assert np.mean(square < squared_radius(share, 3, 4.0)) == pytest.approx(share, abs=0.006)


def test_a_direction_that_rounding_took_is_no_failure():
    flat = np.array([[1.0, 1e3, 0.0], [1e3, 1e6 - 1e-9, 0.0], [0.0, 0.0, 1e-8]])
    root = root_of(flat)
    assert root @ root.T == pytest.approx(flat, rel=1e-9, abs=1e-12)
    assert np.isfinite(draw(np.random.default_rng(0), flat, 4.0, 100)).all()

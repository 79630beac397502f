"""Frames that err alike: the sums of ``spin.noise`` against the dense normal law that they stand for."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from service.inference.spin import noise
from service.inference.spin.noise import Linear


def linear(n: int, p: int, stations: int = 1) -> Linear:
    rng = np.random.default_rng(0)
    times = 20 * (np.arange(n) + rng.uniform(0, 0.9, n)) / n
    given = rng.normal(size=(n, 3)), rng.normal(size=(n, 3, p)), rng.chisquare(4, n) / 4
    station = rng.integers(0, stations, n)
    return Linear(times, *given, np.array([1e-2, 1.0, 1.0, 0.5]), rng.normal(size=p), station)


def staying(one: Linear, tau: float, *, smooth: bool) -> np.ndarray:
    """Matern's kernel of 3/2 or 1/2 within each station."""
    away = np.abs(one.time_s[:, None] - one.time_s) / tau
    kernel = (1 + np.sqrt(3) * away) * np.exp(-np.sqrt(3) * away) if smooth else np.exp(-away)
    return (one.station[:, None] == one.station) * kernel


@pytest.mark.parametrize("smooth", [False, True])
@pytest.mark.parametrize(("a", "tau", "stations"), [(0.0, 1.0, 1), (0.5, 3.0, 1), (0.8, 30.0, 1), (0.8, 3.0, 2)])
def test_evidence_and_posterior_are_the_dense_ones(a, tau, stations, smooth):
    one, scale = linear(25, 4, stations), 1.3
    jacobian = one.jacobian.reshape(-1, 4)
    law = a * staying(one, tau, smooth=smooth) + (1 - a) * np.diag(1 / one.weight)
    errors = scale**2 * np.kron(law, np.eye(3))
    sums = noise._together(
        [noise._Law(a, tau, smooth, 0.0, 1.0, 0, noise._sums(one, rows, a, tau, smooth)) for rows in one.parts()]
    )
    found = noise._at_scales(one, sums, np.array([scale]))
    step, covariance, log = (part[0] for part in found)
    inverse = np.linalg.inv(jacobian.T @ np.linalg.solve(errors, jacobian) + np.diag(one.precision))
    slope = jacobian.T @ np.linalg.solve(errors, one.residual.ravel()) + one.precision * one.away
    np.testing.assert_allclose(covariance, inverse, rtol=1e-8, atol=1e-12)
    np.testing.assert_allclose(step, -inverse @ slope, rtol=1e-8, atol=1e-10)
    # Of the residuals, the parameters integrated out under their prior.
    seen = one.residual.ravel() - jacobian @ one.away
    whole = errors + jacobian @ np.diag(1 / one.precision) @ jacobian.T
    expected = multivariate_normal(np.zeros(len(seen)), whole).logpdf(seen)
    sigma = noise.SCALE_LOG_SIGMA
    of_scale = -0.5 * (np.log(scale) / sigma) ** 2 - np.log(sigma) - 0.5 * np.log(2 * np.pi)
    density = 0.5 * np.sum(np.log(one.precision)) - 2 * np.log(2 * np.pi)  # of the prior at its mean
    density -= 0.5 * np.sum(one.precision * one.away**2)
    assert log + density - of_scale == pytest.approx(expected, abs=1e-6)


@pytest.mark.parametrize("smooth", [False, True])
@pytest.mark.parametrize("stations", [1, 3])
def test_what_is_each_frames_own_is_the_dense_one(stations, smooth):
    one, a, tau, scale = linear(25, 4, stations), 0.5, 3.0, 1.3
    stays = a * staying(one, tau, smooth=smooth)
    own = (1 - a) * np.diag(1 / one.weight)
    gain = own @ np.linalg.inv(stays + own)
    left = gain @ one.residual
    spread = np.diag(own - gain @ own) * scale**2
    expected = (np.sum(left**2, axis=1) + 3 * spread) / ((1 - a) * scale**2)
    laws = [noise._Law(a, tau, smooth, 0.0, 1.0, 0, None)] * stations
    np.testing.assert_allclose(noise._own_squares(one, laws, scale, np.zeros(4)), expected, rtol=1e-8)


@pytest.mark.parametrize("smooth", [False, True])
def test_a_fast_camera_whose_errors_stay_for_long_is_the_dense_one(smooth):
    rng, n, tau = np.random.default_rng(1), 200, 100.0
    times, residual = np.arange(n) * 0.1, rng.normal(size=(n, 3))
    one = Linear(times, residual, np.zeros((n, 3, 1)), np.ones(n), np.ones(1), np.zeros(1), np.zeros(n, int))
    sums = noise._sums(one, np.arange(n), 0.9, tau, smooth)
    law = 0.9 * staying(one, tau, smooth=smooth) + 0.1 * np.eye(n)
    assert sums.squares == pytest.approx(np.sum(residual * np.linalg.solve(law, residual)), rel=1e-6)
    assert sums.log_determinant == pytest.approx(3 * np.linalg.slogdet(law)[1], rel=1e-6)


@pytest.mark.parametrize("smooth", [False, True])
def test_frames_of_one_time_are_held_a_little_apart(smooth):
    one = linear(25, 4)
    twice = np.repeat(one.time_s[:12], 2)
    sums = noise._sums(replace(one, time_s=np.append(twice, twice[-1])), np.arange(25), 0.8, 100.0, smooth)
    assert np.isfinite(sums.squares)
    assert np.all(np.linalg.eigvalsh(sums.normal) > 0)


def test_a_station_whose_errors_are_larger_is_the_same_in_units_of_its_scale():
    one, rows = linear(25, 4), np.arange(25)
    plain = noise._sums(one, rows, 0.5, 3.0, True)
    found = noise._at_scales(one, plain, np.array([1.3]))
    scaled = noise._at_scales(one, plain.scaled(1.3, 25), np.array([1.0]))
    np.testing.assert_allclose(scaled[0], found[0])
    np.testing.assert_allclose(scaled[1], found[1])
    of_scale = -0.5 * (np.log(1.3) / noise.SCALE_LOG_SIGMA) ** 2
    assert scaled[2][0] + of_scale == pytest.approx(found[2][0])

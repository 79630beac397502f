"""The mixture posterior against closed forms: Gaussian modes under Gaussian likelihoods in the tangent space.

A mode N(0, P) with rates N(mu + B x, A A') and a likelihood exp(-(x - m)' S^-1 (x - m) / 2) to the power beta have
the posterior N(C beta S^-1 m, C), C = (P^-1 + beta S^-1)^-1, the evidence (det(S / beta) / det(P + S / beta))^(1/2)
exp(-m' (P + S / beta)^-1 m / 2), and rates N(mu + B x, A A') with x from the posterior. Rotations are small, so that
the space is flat to some 1e-4.
"""

import numpy as np
import pytest

from service.inference.mixture import draw, posterior
from service.inference.pose import exp_so3, local, multiply, retract
from service.inference.proposal import Component, Proposal
from service.inference.state import Poses
from service.inference.weights import normalise

D = 7
DEVIATION = np.array([0.06, 0.05, 0.04, 3.0, 2.0, 0.1, 8.0])
OFFSET = np.array([0.03, -0.02, 0.0, 2.0, -1.5, 0.06, 5.0])
ORIGIN = Poses(np.array([[0.5, -0.5, 0.5, 0.5]]), np.array([[30.0, 20.0]]), np.array([1.0]), np.array([[10.0]]))
AROUND = retract(ORIGIN, np.array([[0.0, np.deg2rad(120), 0.0, 0, 0, 0, 0]]))  # another mode


def philox(seed: int) -> np.random.Generator:
    return np.random.Generator(np.random.Philox(seed))


def correlated(seed: int, width: np.ndarray) -> np.ndarray:
    """(7, 7) covariance with these deviations and correlations between all coordinates."""
    a = philox(seed).standard_normal((D, D))
    spread = a @ a.T + 3 * np.eye(D)
    deviation = np.sqrt(np.diag(spread))
    return np.asarray(spread / np.outer(deviation, deviation) * np.outer(width, width))


P = correlated(1, DEVIATION)
S = correlated(3, DEVIATION * np.array([0.2, 0.4, 0.7, 0.1, 0.5, 0.25, 0.3]))
RATE_MEAN = np.array([0.1, -0.2, 0.05, 4.0, 0.0, 0.02, -6.0])
SLOPE = philox(4).standard_normal((D, D)) * np.outer(3 * DEVIATION, 1 / DEVIATION) / np.sqrt(D)
RATE_FACTOR = np.linalg.cholesky(correlated(5, DEVIATION))
PART = Component(0.0, ORIGIN, P, RATE_MEAN, SLOPE, RATE_FACTOR)


def peak(centre: Poses, offset: np.ndarray, covariance: np.ndarray):
    inverse = np.linalg.inv(covariance)

    def score(poses: Poses) -> np.ndarray:
        z = local(centre, poses) - offset
        return -0.5 * np.einsum("ni,ij,nj->n", z, inverse, z)

    return score


def closed_form(beta: float) -> tuple[np.ndarray, np.ndarray, float]:
    """Mean, covariance and log evidence of the mode times L^beta."""
    inverse = beta * np.linalg.inv(S)
    covariance = np.linalg.inv(np.linalg.inv(P) + inverse)
    total = P + S / beta
    log_evidence = 0.5 * (np.linalg.slogdet(S / beta)[1] - np.linalg.slogdet(total)[1])
    log_evidence -= 0.5 * OFFSET @ np.linalg.solve(total, OFFSET)
    return covariance @ inverse @ OFFSET, covariance, float(log_evidence)


@pytest.mark.parametrize("beta", [0.05, 1.0])
def test_poses_rates_and_evidence_are_those_of_the_closed_form(beta):
    """Ten runs of 2,000 particles. Standard errors: 0.01 of a mean, 0.015 of a covariance, 0.01 nats."""
    mean, covariance, log_evidence = closed_form(beta)
    whiten = np.linalg.inv(np.linalg.cholesky(covariance))
    rate_mean = RATE_MEAN + SLOPE @ mean
    rate_covariance = SLOPE @ covariance @ SLOPE.T + RATE_FACTOR @ RATE_FACTOR.T
    rate_whiten = np.linalg.inv(np.linalg.cholesky(rate_covariance))
    moments, evidences = [], []
    for seed in range(10):
        draws = posterior(philox(seed), [PART], peak(ORIGIN, OFFSET, S), beta, 2000)
        log_weights, log_sum = normalise(draws.log_weights)
        z = np.hstack(
            [
                (local(ORIGIN, draws.poses) - mean) @ whiten.T,
                (draws.rates - rate_mean) @ rate_whiten.T,
                np.ones((2000, 1)),
            ]
        )
        moments.append(np.einsum("n,ni,nj->ij", np.exp(log_weights), z, z))
        evidences.append(log_sum)
    moment = np.mean(moments, axis=0)
    assert np.mean(evidences) == pytest.approx(log_evidence, abs=0.05)
    np.testing.assert_allclose(moment[-1, :-1], 0, atol=0.05)
    np.testing.assert_allclose(moment[:D, :D], np.eye(D), atol=0.08)
    np.testing.assert_allclose(moment[D:-1, D:-1], np.eye(D), atol=0.08)
    cross = whiten @ covariance @ SLOPE.T @ rate_whiten.T
    np.testing.assert_allclose(moment[:D, D:-1], cross, atol=0.08)


def test_weights_are_unbiased_whatever_the_proposal():
    """E[sum w f] = evidence x E[f] for f = 1, x and x^2, over 400 seeds of 60 draws from a proposal that is off."""
    mean, covariance, log_evidence = closed_form(1.0)
    off = Proposal(mean + 0.5 * np.sqrt(np.diag(covariance)), np.linalg.cholesky(2.0 * covariance + 0.02 * P))
    z0 = np.sqrt(np.diag(covariance))
    sums = []
    for seed in range(400):
        draws = draw(philox(seed), PART, off, peak(ORIGIN, OFFSET, S), 1.0, 60)
        weights = np.exp(draws.log_weights - log_evidence)
        z = (local(ORIGIN, draws.poses) - mean) / z0
        sums.append(np.concatenate([[weights.sum()], weights @ z, weights @ z**2]))
    found, error = np.mean(sums, axis=0), np.std(sums, axis=0) / np.sqrt(len(sums))
    expected = np.concatenate([[1.0], np.zeros(D), np.ones(D)])
    assert error.max() < 0.05
    assert np.all(np.abs(found - expected) < 4 * error)


def test_weights_are_unbiased_after_adaptation():
    """The same through ``posterior``: few particles, so that every run's own proposal and shares count."""
    mean, covariance, log_evidence = closed_form(0.3)
    z0 = np.sqrt(np.diag(covariance))
    halves = [Component(np.log(w), PART.mean, P, RATE_MEAN, SLOPE, RATE_FACTOR) for w in (0.9, 0.1)]
    sums = []
    for seed in range(150):
        draws = posterior(philox(seed), halves, peak(ORIGIN, OFFSET, S), 0.3, 100)
        weights = np.exp(draws.log_weights - log_evidence)
        z = (local(ORIGIN, draws.poses) - mean) / z0
        sums.append(np.concatenate([[weights.sum()], weights @ z, weights @ z**2]))
    found, error = np.mean(sums, axis=0), np.std(sums, axis=0) / np.sqrt(len(sums))
    expected = np.concatenate([[1.0], np.zeros(D), np.ones(D)])
    assert error.max() < 0.05
    assert np.all(np.abs(found - expected) < 4 * error)


def test_two_modes_keep_the_ratio_of_their_masses():
    """Prior 0.2 and 0.8, peaks of other heights and widths; ratio of the evidences known, and nothing leaks."""
    narrow = correlated(8, 0.5 * DEVIATION)
    heights = np.array([6.0, 4.0])
    peaks = [peak(ORIGIN, np.zeros(D), S), peak(AROUND, OFFSET, narrow)]

    def score(poses: Poses) -> np.ndarray:
        return np.logaddexp(heights[0] + peaks[0](poses), heights[1] + peaks[1](poses))

    parts = [
        Component(np.log(0.2), ORIGIN, P, RATE_MEAN, SLOPE, RATE_FACTOR),
        Component(np.log(0.8), AROUND, P, RATE_MEAN, SLOPE, RATE_FACTOR),
    ]
    masses = []
    for share, height, offset, s in ((0.2, 6.0, np.zeros(D), S), (0.8, 4.0, OFFSET, narrow)):
        total = P + s
        log_mass = np.log(share) + height + 0.5 * (np.linalg.slogdet(s)[1] - np.linalg.slogdet(total)[1])
        masses.append(np.exp(log_mass - 0.5 * offset @ np.linalg.solve(total, offset)))
    found = []
    for seed in range(10):
        draws = posterior(philox(seed), parts, score, 1.0, 1000)
        first = np.linalg.norm(local(ORIGIN, draws.poses)[:, :3], axis=1) < np.pi / 3
        weights = np.exp(draws.log_weights)
        found.append([weights[first].sum(), weights[~first].sum()])
        assert 40 <= np.count_nonzero(first) <= 960
    np.testing.assert_allclose(np.mean(found, axis=0), masses, rtol=0.04)
    ratio = np.array(found)[:, 0] / np.sum(found, axis=1)
    np.testing.assert_allclose(ratio, masses[0] / np.sum(masses), atol=0.06)


def test_a_mode_cut_in_two_is_the_mode():
    """Components that overlap are a sum: the halves' draws together have the whole's mean and evidence."""
    mean, covariance, log_evidence = closed_form(1.0)
    halves = [Component(np.log(0.5), ORIGIN, P, RATE_MEAN, SLOPE, RATE_FACTOR)] * 2
    draws = posterior(philox(1), halves, peak(ORIGIN, OFFSET, S), 1.0, 4000)
    log_weights, log_sum = normalise(draws.log_weights)
    assert log_sum == pytest.approx(log_evidence, abs=0.1)
    off = np.exp(log_weights) @ (local(ORIGIN, draws.poses) - mean) / np.sqrt(np.diag(covariance))
    np.testing.assert_allclose(off, 0, atol=0.12)


def test_a_peak_that_turns_a_corner_is_followed():
    """A ridge: the peak's second coordinate follows the square of the first. Evidence and mean by quadrature."""
    part = Component(0.0, ORIGIN, np.diag(DEVIATION**2), np.zeros(D), np.zeros((D, D)), np.zeros((D, D)))

    def score(poses: Poses) -> np.ndarray:
        x = local(ORIGIN, poses) / DEVIATION
        return -0.5 * ((x[:, 3] - 1.0) / 0.5) ** 2 - 0.5 * ((x[:, 4] - 0.7 * x[:, 3] ** 2) / 0.15) ** 2

    u, v = np.meshgrid(np.linspace(-5, 5, 801), np.linspace(-5, 8, 1041), indexing="ij")
    log_density = -0.5 * (u**2 + v**2) - 0.5 * ((u - 1.0) / 0.5) ** 2 - 0.5 * ((v - 0.7 * u**2) / 0.15) ** 2
    density = np.exp(log_density) / (2 * np.pi) * (10 / 800) * (13 / 1040)
    runs = []
    for seed in range(60):
        draws = posterior(philox(seed), [part], score, 1.0, 1000)
        x = local(ORIGIN, draws.poses) / DEVIATION
        weights = np.exp(draws.log_weights)
        runs.append([weights.sum(), weights @ x[:, 3], weights @ x[:, 4], weights @ (x[:, 3] * x[:, 4])])
    expected = [np.sum(density * f) for f in (np.ones_like(u), u, v, u * v)]
    error = np.std(runs, axis=0) / np.sqrt(len(runs))
    assert np.all(error < 0.05 * np.array(expected))
    assert np.all(np.abs(np.mean(runs, axis=0) - expected) < 4 * error)


def test_rotations_are_moved_in_the_space_of_the_components_mean():
    """A component elsewhere in the space of rotations finds a peak given in its own tangent coordinates."""
    turned = Poses(
        multiply(AROUND.quaternion, exp_so3(np.zeros((1, 3)))), AROUND.position, AROUND.log_scale, AROUND.joints
    )
    part = Component(0.0, turned, P, RATE_MEAN, SLOPE, RATE_FACTOR)
    mean, covariance, _ = closed_form(1.0)
    draws = posterior(philox(3), [part], peak(AROUND, OFFSET, S), 1.0, 3000)
    log_weights, _ = normalise(draws.log_weights)
    off = np.exp(log_weights) @ (local(AROUND, draws.poses) - mean) / np.sqrt(np.diag(covariance))
    np.testing.assert_allclose(off, 0, atol=0.12)

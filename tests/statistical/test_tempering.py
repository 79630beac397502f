"""Tempering against closed forms: a Gaussian likelihood in tangent coordinates with a Gaussian prediction.

With prediction N(0, P) and likelihood exp(-(z - m)' S^-1 (z - m) / 2), both in the tangent space at one pose, the
posterior is N(C S^-1 m, C), C = (P^-1 + S^-1)^-1, and the evidence (det S / det(P + S))^(1/2)
exp(-m' (P + S)^-1 m / 2). Rotations are small, so that the space is flat to some 1e-4.
"""

import numpy as np
import pytest
from scipy import stats

from service.inference.articulation import Articulation, Joint, Stage
from service.inference.modes import metric_of
from service.inference.motion import propagate
from service.inference.pose import exp_so3, local, multiply, retract, rotation_matrices
from service.inference.resample import RESAMPLERS
from service.inference.state import Poses
from service.inference.tempering import Population, Tempering, move, temper

COUNT = 4000
DEVIATION = np.array([0.06, 0.05, 0.04, 3.0, 2.0, 0.1, 8.0])
PREDICTION = np.diag(DEVIATION**2)
OFFSET = np.array([0.03, -0.02, 0.0, 2.0, -1.5, 0.06, 5.0])
BOOM = Joint("boom", "prismatic", -1000, 1000, 0.0, (Stage("prismatic", ("boom",), (0, 0, 1)),))
METRIC = metric_of(Articulation(("bus", "boom"), (BOOM,)))


def likelihood_covariance() -> np.ndarray:
    """A narrow Gaussian with correlations between all coordinates."""
    a = np.random.default_rng(3).standard_normal((7, 7))
    spread = a @ a.T + 3 * np.eye(7)
    correlation = spread / np.sqrt(np.outer(np.diag(spread), np.diag(spread)))
    width = DEVIATION * np.array([0.2, 0.4, 0.7, 0.1, 0.5, 0.25, 0.3])
    return np.asarray(correlation * np.outer(width, width))


S = likelihood_covariance()
S_INVERSE = np.linalg.inv(S)


def at_rest(count: int) -> Poses:
    quaternion = np.tile([0.5, -0.5, 0.5, 0.5], (count, 1))
    return Poses(quaternion, np.tile([30.0, 20.0], (count, 1)), np.full(count, 1.0), np.full((count, 1), 10.0))


ORIGIN = at_rest(1)


def score(poses: Poses) -> np.ndarray:
    z = local(ORIGIN, poses) - OFFSET
    return -0.5 * np.einsum("ni,ij,nj->n", z, S_INVERSE, z)


def everywhere(poses: Poses) -> np.ndarray:
    return np.ones(len(poses), bool)


def philox(seed: int) -> np.random.Generator:
    return np.random.Generator(np.random.Philox(seed))


def closed_form(beta: float) -> tuple[np.ndarray, np.ndarray, float]:
    """Mean, covariance and log evidence of the prediction times L^beta."""
    covariance = np.linalg.inv(np.linalg.inv(PREDICTION) + beta * S_INVERSE)
    total = PREDICTION + S / beta
    log_evidence = 0.5 * (np.linalg.slogdet(S / beta)[1] - np.linalg.slogdet(total)[1])
    log_evidence -= 0.5 * OFFSET @ np.linalg.solve(total, OFFSET)
    return covariance @ (beta * S_INVERSE @ OFFSET), covariance, float(log_evidence)


def predicted(rng: np.random.Generator, count: int = COUNT) -> Population:
    centre = at_rest(count)
    poses = propagate(rng, centre, DEVIATION)
    return Population(poses, score(poses), centre, np.zeros((count, 7)))


def plan(exponent: float = 1.0, moves: int = 20, resampler: str = "systematic") -> Tempering:
    return Tempering(exponent, 0.5, moves, resampler, DEVIATION, METRIC)


@pytest.mark.parametrize("resampler", RESAMPLERS)
def test_evidence_and_posterior_are_those_of_the_closed_form(resampler):
    """Six independent runs with each resampler; bounds are several times the spread between runs (0.3 nats)."""
    mean, covariance, log_evidence = closed_form(1.0)
    whiten = np.linalg.inv(np.linalg.cholesky(covariance))
    evidences, pooled = [], []
    for seed in range(6):
        population, found, steps = temper(
            philox(seed), predicted(philox(100 + seed)), score, everywhere, plan(resampler=resampler), COUNT
        )
        assert steps >= 20
        np.testing.assert_allclose(population.log_likelihood, score(population.poses), rtol=1e-9, atol=1e-9)
        evidences.append(found)
        pooled.append((local(ORIGIN, population.poses) - mean) @ whiten.T)
    assert np.mean(evidences) == pytest.approx(log_evidence, abs=0.5)
    z = np.concatenate(pooled)
    np.testing.assert_allclose(z.mean(axis=0), 0, atol=0.15)
    np.testing.assert_allclose(np.cov(z.T), np.eye(7), atol=0.2)


def test_a_power_of_the_likelihood_ends_where_it_should():
    mean, covariance, log_evidence = closed_form(0.05)
    population, found, _ = temper(philox(1), predicted(philox(2)), score, everywhere, plan(0.05), COUNT)
    z = (local(ORIGIN, population.poses) - mean) @ np.linalg.inv(np.linalg.cholesky(covariance)).T
    np.testing.assert_allclose(z.mean(axis=0), 0, atol=0.2)
    np.testing.assert_allclose(np.cov(z.T), np.eye(7), atol=0.3)
    assert found == pytest.approx(log_evidence, abs=0.3)


def test_the_number_of_particles_may_change_on_the_way():
    mean, _, _ = closed_form(1.0)
    population, _, _ = temper(philox(1), predicted(philox(2), 6000), score, everywhere, plan(), 500)
    assert len(population.log_likelihood) == len(population.poses) == len(population.rates) == 500
    assert population.centre is not None
    assert len(population.centre) == 500
    offset = local(ORIGIN, population.poses).mean(axis=0) - mean
    assert np.all(np.abs(offset) < 0.3 * DEVIATION)  # about four standard errors of a few moves from 500


@pytest.mark.parametrize("beta", [0.03, 1.0])
def test_moves_leave_the_target_as_it_is(beta):
    """A population drawn from the target stays one: every coordinate by Kolmogorov-Smirnov, and the covariance."""
    rng = philox(7)
    mean, covariance, _ = closed_form(beta)
    factor = np.linalg.cholesky(covariance)
    centre = at_rest(COUNT)
    poses = retract(centre, mean + rng.standard_normal((COUNT, 7)) @ factor.T)
    before = Population(poses, score(poses), centre, np.zeros((COUNT, 7)))
    after = before
    for _ in range(20):
        after = move(rng, after, score, everywhere, plan(), beta)
    assert np.mean(np.all(after.poses.quaternion == before.poses.quaternion, axis=1)) < 0.05  # it does move
    z = (local(ORIGIN, after.poses) - mean) @ np.linalg.inv(factor).T
    for column in z.T:
        assert stats.kstest(column, stats.norm.cdf).pvalue > 1e-5
    np.testing.assert_allclose(np.cov(z.T), np.eye(7), atol=5 * np.sqrt(2 / COUNT))


def test_moves_keep_the_weights_of_two_modes():
    """Modes 120 degrees apart, one three times as heavy and twice as wide: shares and widths stay."""
    rng = philox(8)
    half_turn = exp_so3(np.array([[0.0, np.deg2rad(120), 0.0]]))
    second = Poses(multiply(ORIGIN.quaternion, half_turn), ORIGIN.position, ORIGIN.log_scale, ORIGIN.joints)
    narrow = 0.3 * DEVIATION

    def log_target(poses: Poses) -> np.ndarray:
        a = np.sum((local(ORIGIN, poses) / narrow) ** 2, axis=1)
        b = np.sum((local(second, poses) / (2 * narrow)) ** 2, axis=1)
        return np.logaddexp(np.log(0.25) - 0.5 * a, np.log(0.75) - 7 * np.log(2) - 0.5 * b)

    heavy = rng.random(COUNT) < 0.75
    origin = at_rest(COUNT)
    start = Poses(
        np.where(heavy[:, None], second.quaternion, origin.quaternion), origin.position, origin.log_scale, origin.joints
    )
    poses = retract(start, rng.standard_normal((COUNT, 7)) * narrow * np.where(heavy, 2, 1)[:, None])
    population = Population(poses, log_target(poses), None, np.zeros((COUNT, 7)))
    for _ in range(20):
        population = move(rng, population, log_target, everywhere, plan(), 1.0)
    near_second = np.linalg.norm(local(second, population.poses)[:, :3], axis=1) < np.pi / 3
    np.testing.assert_array_equal(near_second, heavy)  # no particle changes its mode
    for centre, width, members in ((ORIGIN, narrow, ~heavy), (second, 2 * narrow, heavy)):
        z = local(centre, population.poses[members]) / width
        np.testing.assert_allclose(z.mean(axis=0), 0, atol=5 / np.sqrt(members.sum()))
        np.testing.assert_allclose(z.std(axis=0), 1, atol=5 / np.sqrt(2 * members.sum()))


def test_nothing_leaves_the_bounds():
    def left_half(poses: Poses) -> np.ndarray:
        return poses.position[:, 0] < 30.0

    rng = philox(9)
    centre = at_rest(1000)
    poses = propagate(rng, centre, DEVIATION)
    population = Population(poses, np.where(left_half(poses), score(poses), -1e6), centre, np.zeros((1000, 7)))
    found, _, _ = temper(rng, population, score, left_half, plan(), 1000)
    assert left_half(found.poses).all()
    assert np.isfinite(found.log_likelihood).all()


def test_moves_leave_a_target_over_the_whole_space_as_it_is():
    """Density exp(k u) on SO(3), u = R_zz: uniform in [-1, 1] before, so the mean of u is coth k - 1 / k."""
    k, count, rng = 1.0, 12_000, philox(5)
    u = np.log(np.exp(-k) + rng.random(count) * (np.exp(k) - np.exp(-k))) / k
    turns = np.array([rng.uniform(0, 2 * np.pi, count), np.arccos(u), rng.uniform(0, 2 * np.pi, count)])
    first, tilt, last = (exp_so3(turn[:, None] * axis) for turn, axis in zip(turns, np.eye(3)[[2, 0, 2]], strict=True))
    still = at_rest(count)
    poses = Poses(multiply(multiply(first, tilt), last), still.position, still.log_scale, still.joints)

    def log_target(poses: Poses) -> np.ndarray:
        z = (local(still, poses) / DEVIATION)[:, 3:]
        return k * rotation_matrices(poses.quaternion)[:, 2, 2] - 0.5 * np.sum(z * z, axis=1)

    poses = Poses(
        poses.quaternion,
        poses.position + rng.standard_normal((count, 2)) * DEVIATION[3:5],
        poses.log_scale + rng.standard_normal(count) * DEVIATION[5],
        poses.joints + rng.standard_normal((count, 1)) * DEVIATION[6],
    )
    population = Population(poses, log_target(poses), None, np.zeros((count, 7)))
    widest = Tempering(1.0, 0.5, 1, "systematic", np.array([0.4, 0.4, 0.4, *DEVIATION[3:]]), METRIC)
    for _ in range(40):
        population = move(rng, population, log_target, everywhere, widest, 1.0)
    after = rotation_matrices(population.poses.quaternion)[:, 2, 2]
    expected = 1 / np.tanh(k) - 1 / k
    deviation = np.sqrt(1 - 2 * expected / k - expected**2)
    assert after.mean() == pytest.approx(expected, abs=5 * deviation / np.sqrt(count))

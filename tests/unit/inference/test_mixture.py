"""The pieces of the mixture posterior, each against what it must be by hand or by another program."""

import dataclasses

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

from service.inference.articulation import Articulation, Joint, Stage
from service.inference.mixture import (
    LEAST_PARTICLES,
    TAIL,
    Draws,
    draw,
    join,
    log_t_constant,
    posterior,
    share_out,
)
from service.inference.modes import metric_of
from service.inference.pose import local, retract
from service.inference.proposal import (
    INFLATION,
    ROUND_ESS,
    Component,
    Proposal,
    adapt,
    component,
    log_density,
    prediction,
    steepest_exponent,
)
from service.inference.state import Poses
from service.inference.weights import effective_sample_size

BOOM = Joint("boom", "prismatic", -1000, 1000, 0.0, (Stage("prismatic", ("boom",), (0, 0, 1)),))
METRIC = metric_of(Articulation(("bus", "boom"), (BOOM,)))
ORIGIN = Poses(np.array([[0.5, -0.5, 0.5, 0.5]]), np.array([[30.0, 20.0]]), np.array([1.0]), np.array([[10.0]]))
DEVIATION = np.array([0.06, 0.05, 0.04, 3.0, 2.0, 0.1, 8.0])


def philox(seed: int) -> np.random.Generator:
    return np.random.Generator(np.random.Philox(seed))


def wide(log_weight: float = 0.0) -> Component:
    """A prediction without correlations, rates all zero."""
    nothing = np.zeros((7, 7))
    return Component(log_weight, ORIGIN, np.diag(DEVIATION**2), np.zeros(7), nothing, nothing)


def flat(poses: Poses) -> np.ndarray:
    return np.zeros(len(poses))


@given(st.lists(st.floats(1e-6, 1.0), min_size=1, max_size=12), st.integers(1, 3000))
def test_shares_are_whole_and_sum_up(values, count):
    """Every mode gets its least number; beyond it the counts are off by less than one, but for the greatest."""
    shares = np.array(values) / np.sum(values)
    counts = share_out(shares, count)
    least = min(LEAST_PARTICLES, count // len(shares))
    assert counts.sum() == count
    assert counts.min() >= least
    ideal = least + shares * (count - least * len(shares))
    others = np.arange(len(shares)) != np.argmax(shares)
    assert np.all(np.abs(counts - ideal)[others] < 1 + 1e-9)
    assert abs(counts - ideal).max() < len(shares) + 1e-9


def test_shares_by_hand():
    np.testing.assert_array_equal(share_out(np.array([0.75, 0.25]), 480), [40 + 300, 40 + 100])
    np.testing.assert_array_equal(share_out(np.array([0.001, 0.999]), 100), [40, 60])
    np.testing.assert_array_equal(share_out(np.array([1.0]), 7), [7])
    np.testing.assert_array_equal(share_out(np.array([0.2, 0.5, 0.3]), 2), [0, 2, 0])  # fewer particles than modes


def test_an_even_likelihood_is_taken_at_once():
    assert steepest_exponent(np.zeros(100), np.full(100, -7.0), 0.05) == 0.05


def test_the_steepest_exponent_keeps_enough_of_the_draws():
    """Of all rungs of the ladder the highest that does."""
    log_likelihood = -0.5 * np.linspace(0, 40, 150) ** 2
    beta = steepest_exponent(np.zeros(150), log_likelihood, 1.0)
    assert effective_sample_size(beta * log_likelihood) >= ROUND_ESS * 150
    assert effective_sample_size(beta / 0.75 * log_likelihood) < ROUND_ESS * 150


def test_where_no_exponent_keeps_enough_the_best_is_taken():
    """Weights that the exponent must undo: two draws count without the likelihood, none of the ladder is enough."""
    base = np.concatenate([np.zeros(2), np.full(98, -1000.0)])
    log_likelihood = np.concatenate([np.zeros(1), np.full(1, -1.0), np.full(98, 0.0)])
    beta = steepest_exponent(base, log_likelihood, 1.0)
    assert beta == pytest.approx(0.75**39)  # the smallest: the two stay as even as can be


def test_the_density_of_a_proposal_is_scipys():
    rng = philox(1)
    a = rng.standard_normal((7, 7))
    covariance, mean = a @ a.T + np.eye(7), rng.standard_normal(7)
    x = rng.standard_normal((20, 7))
    found = log_density(Proposal(mean, np.linalg.cholesky(covariance)), x) - 3.5 * np.log(2 * np.pi)
    np.testing.assert_allclose(found, stats.multivariate_normal(mean, covariance).logpdf(x))


@pytest.mark.parametrize("d", [6, 9])
def test_the_constant_of_student_t_is_scipys(d):
    expected = stats.multivariate_t(np.zeros(d), np.eye(d), df=TAIL).logpdf(np.zeros(d))
    assert log_t_constant(d) - 0.5 * d * np.log(2 * np.pi) == pytest.approx(expected)


def test_the_draws_have_the_tails_that_their_weights_assume():
    """Under a flat likelihood weight = prediction / t: a factor of two in the tails would show."""
    rng = philox(2)
    part = wide()
    d = draw(rng, part, prediction(part), flat, 1.0, 4000)
    x = local(ORIGIN, d.poses) / DEVIATION
    expected = stats.multivariate_normal(np.zeros(7), np.eye(7)).logpdf(x)
    expected -= stats.multivariate_t(np.zeros(7), np.eye(7), df=TAIL).logpdf(x) + np.log(4000)
    np.testing.assert_allclose(d.log_weights, expected, atol=1e-6)
    assert stats.kstest(np.sum(x**2, axis=1) / 7, stats.f(7, TAIL).cdf).pvalue > 1e-4


def test_a_component_has_the_moments_of_its_particles():
    """Mean, covariance, and the regression of rates on poses: with the residuals they give the rates' covariance."""
    rng = philox(3)
    z = rng.standard_normal((500, 14)) @ (0.3 * rng.standard_normal((14, 14)) + np.eye(14)).T
    x, v = 0.02 * z[:, :7], 0.1 * z[:, 7:]
    weights = rng.random(500)
    weights /= weights.sum()
    least = 0.001 * np.arange(1.0, 8.0)
    part = component(retract(ORIGIN, x), v, weights, ORIGIN, METRIC, -0.7, least)
    centre = weights @ x
    moment = np.cov(np.hstack([x, v]).T, aweights=weights, ddof=0)
    np.testing.assert_allclose(local(ORIGIN, part.mean)[0], centre, atol=1e-12)
    np.testing.assert_allclose(part.covariance, moment[:7, :7] + np.diag(least**2), rtol=1e-9, atol=1e-14)
    np.testing.assert_allclose(part.rate_slope @ part.covariance, moment[7:, :7], rtol=1e-7, atol=1e-12)
    total = part.rate_slope @ part.covariance @ part.rate_slope.T + part.rate_factor @ part.rate_factor.T
    np.testing.assert_allclose(total, moment[7:, 7:], rtol=1e-7, atol=1e-12)
    np.testing.assert_allclose(part.rate_mean, weights @ v)
    assert part.log_weight == -0.7


def test_one_particle_makes_a_component_too():
    part = component(ORIGIN, np.ones((1, 7)), np.ones(1), ORIGIN, METRIC, 0.0, DEVIATION)
    np.testing.assert_allclose(part.covariance, np.diag(DEVIATION**2))
    np.testing.assert_allclose(part.rate_factor, 0)
    np.testing.assert_allclose(part.rate_mean, 1)


def test_a_proposal_that_has_nothing_to_learn_stays_about_where_it_is():
    """Flat likelihood: evidence 1, the mean near the prediction's, no direction lost."""
    adapted = adapt(philox(4), wide(), flat, 1.0)
    proposal = adapted.proposal
    assert adapted.peak == 0.0
    assert adapted.log_evidence == pytest.approx(0, abs=0.3)
    assert np.all(np.abs(proposal.mean) < 0.5 * DEVIATION)
    ratio = np.linalg.eigvalsh(proposal.factor @ proposal.factor.T / np.outer(DEVIATION, DEVIATION))
    assert ratio.min() > 0.5
    assert ratio.max() < 2.5 * INFLATION


def test_join_keeps_everything():
    a, b = (draw(philox(k), wide(), prediction(wide()), flat, 1.0, k) for k in (3, 5))
    both = join(a, b)
    assert len(both.poses) == len(both.rates) == 8
    np.testing.assert_array_equal(both.log_weights, np.concatenate([a.log_weights, b.log_weights]))
    np.testing.assert_array_equal(both.poses.joints[3:], b.poses.joints)


def test_the_same_generator_gives_the_same_draws_and_asks_for_exactly_the_particles():
    def run() -> Draws:
        return posterior(philox(5), [wide(np.log(0.6)), wide(np.log(0.4))], flat, 0.1, 333)

    first, second = run(), run()
    assert len(first.poses) == 333
    for name in ("rates", "log_likelihood", "log_weights"):
        assert getattr(first, name).tobytes() == getattr(second, name).tobytes()
    assert first.poses.quaternion.tobytes() == second.poses.quaternion.tobytes()


def test_modes_are_weighed_by_an_exponent_of_their_own():
    """Two flat modes, one 100 nats lower: their odds are exp(-100 x between), their inside is as without it."""
    far = Poses(ORIGIN.quaternion[:, [1, 0, 3, 2]], ORIGIN.position, ORIGIN.log_scale, ORIGIN.joints)
    parts = [wide(), dataclasses.replace(wide(), mean=far)]

    def score(poses: Poses) -> np.ndarray:
        return np.where(np.abs(poses.quaternion @ ORIGIN.quaternion[0]) > 0.7, 500.0, 400.0)

    log_odds = {}
    for between in (0.07, 0.03):
        draws = posterior(philox(5), parts, score, 0.07, 2000, between)
        here = draws.log_likelihood == 500.0
        log_odds[between] = np.logaddexp.reduce(draws.log_weights[~here]) - np.logaddexp.reduce(draws.log_weights[here])
        assert np.logaddexp.reduce(draws.log_weights[here]) == pytest.approx(between * 500, abs=0.1)
    assert log_odds[0.07] == pytest.approx(-7.0, abs=0.2)
    assert log_odds[0.03] == pytest.approx(-3.0, abs=0.2)


@pytest.mark.parametrize("exponent", [0.2, 0.07, 0.03])
def test_evidence_does_not_depend_on_the_exponent_within_a_mode(exponent):
    """What is found apart, and other models, can be held against each other whatever power each was found with."""
    alone = posterior(philox(6), [wide()], lambda poses: np.full(len(poses), 400.0), exponent, 500, 0.03)
    assert np.logaddexp.reduce(alone.log_weights) == pytest.approx(0.03 * 400, abs=0.1)

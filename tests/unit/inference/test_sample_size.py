"""The number of particles follows the posterior: Fox's bound, and the effective sample size."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

from service.inference.articulation import Articulation
from service.inference.domain import Domain
from service.inference.params import FilterParams, PriorParams, SessionConfig
from service.inference.pose import retract
from service.inference.sample_size import KLD_NATS, adapted, ess_size, kld_size, occupied_bins
from service.inference.state import FilterState, Poses

DOMAIN = Domain(200, 200, 1.0, Articulation(("body",), ()), PriorParams())
ORIGIN = Poses(np.array([[1.0, 0, 0, 0]]), np.array([[100.0, 100.0]]), np.log([40.0]), np.zeros((1, 0)))


def state(width: float, count: int = 2000, status: str = "tracking") -> FilterState:
    """A Gaussian about one pose, ``width`` times a bin wide in each direction."""
    rng = np.random.default_rng(5)
    x = width * rng.standard_normal((count, 6)) * [0.035, 0.035, 0.035, 2.0, 2.0, 0.02]
    poses = retract(ORIGIN, x)
    return FilterState(poses, np.full(count, -np.log(count)), np.zeros((count, 6)), 4, 0.4, status, {})


@pytest.mark.parametrize("bins", [2, 5, 50, 1000])
def test_foxs_bound_is_the_chi_square_quantile(bins):
    assert kld_size(bins) == pytest.approx(stats.chi2.ppf(0.99, bins - 1) / (2 * KLD_NATS), rel=0.03, abs=2)


def test_a_narrow_posterior_fills_few_bins():
    bins = [occupied_bins(state(width), DOMAIN) for width in (1e-6, 0.3, 1.0)]
    assert bins[0] <= 64  # a corner at most
    assert bins[0] < bins[1] < bins[2] <= 2000


def test_light_particles_fill_no_bins():
    wide = state(1.0)
    log_weights = np.full(2000, -40.0)
    log_weights[:10] = -np.log(10)
    assert occupied_bins(replace(wide, log_weights=log_weights), DOMAIN) <= 10


def test_enough_effective_particles():
    uneven = state(1.0)
    log_weights = np.where(np.arange(2000) < 200, -np.log(200), -800.0)  # one in ten counts
    assert ess_size(replace(uneven, log_weights=log_weights), 100.0) == pytest.approx(1000, abs=1)
    assert ess_size(uneven, 100.0) == pytest.approx(100, abs=1)  # the ceiling of a rounded sum


@pytest.mark.parametrize("rule", ["ess", "kld"])
def test_bounds_and_what_is_not_tracked(rule):
    config = SessionConfig(FilterParams(particles=900, adaptive=rule, least_particles=150, enough_ess=50))
    assert adapted(config, state(1e-6), DOMAIN).filter.particles <= 900
    assert adapted(config, state(1e-6), DOMAIN).filter.particles >= 150
    assert adapted(config, None, DOMAIN) is config
    for status in ("acquiring", "lost", "no_target"):
        assert adapted(config, state(1e-6, status=status), DOMAIN) is config
    off = SessionConfig(FilterParams(particles=900))
    assert adapted(off, state(1e-6), DOMAIN) is off


def test_a_wide_posterior_takes_all_of_them():
    config = SessionConfig(FilterParams(particles=900, adaptive="kld"))
    assert adapted(config, state(1.0), DOMAIN).filter.particles == 900

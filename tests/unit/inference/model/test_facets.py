"""Facets of one piece: a normal law in which what they have in common is an unknown like any other."""

import numpy as np
import pytest

from service.inference.model import prior
from service.inference.model.facets import Facets, facets_of

PIECES = np.array([0, 0, 0, 1, 2, 2], np.int32)
FACETS = facets_of(PIECES, (6, 6))
ALONE = np.repeat([prior.ALBEDO_SIGMA**-2, prior.GLOSS_LOG_SIGMA**-2], 6)
OWN = np.where(FACETS.own > 0, FACETS.own, ALONE)


def brute(information: np.ndarray, value: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Means and covariance of all planes: with what is common written out, and solved."""
    p, pieces = len(FACETS.own), int(FACETS.piece.max()) + 1
    normal, pull = np.zeros((p + pieces, p + pieces)), np.zeros(p + pieces)
    normal[range(p, p + pieces), range(p, p + pieces)] = 1e-9  # what nothing hangs on
    for k in range(p):
        normal[k, k] += information[k]
        pull[k] += information[k] * value[k]
        a = p + FACETS.piece[k]
        if FACETS.own[k] > 0:
            normal[np.ix_([k, a], [k, a])] += FACETS.own[k] * np.array([[1, -1], [-1, 1]])
            normal[a, a] += FACETS.common[k] / (FACETS.piece == FACETS.piece[k]).sum()
        else:
            normal[k, k] += ALONE[k]
    covariance = np.linalg.inv(normal)
    return (covariance @ pull)[:p], covariance[:p, :p]


def test_a_facet_alone_has_the_prior_of_its_piece():
    mean, variance = FACETS.expected(np.zeros(12), OWN)
    assert not mean.any()
    assert variance == pytest.approx(1 / ALONE, rel=1e-5)


def test_means_and_covariance_are_those_of_the_whole_law():
    rng = np.random.default_rng(3)
    information, value = rng.uniform(0, 60, 12) * (rng.uniform(size=12) < 0.6), rng.normal(0, 0.7, 12)
    wanted, covariance = brute(information, value)
    whole = OWN + information
    mean, variance = FACETS.expected(information * value / whole, whole)
    assert mean == pytest.approx(wanted, abs=1e-5)
    assert variance == pytest.approx(np.diag(covariance), rel=1e-5)
    assert FACETS.covariance(whole) == pytest.approx(covariance, abs=1e-6)


def test_a_facet_that_was_never_seen_is_expected_to_be_like_its_piece():
    information, value = np.zeros(12), np.zeros(12)
    information[[0, 1]], value[[0, 1]] = 1e4, -1.0
    whole = OWN + information
    mean, variance = FACETS.expected(information * value / whole, whole)
    assert mean[2] == pytest.approx(-1.0, abs=0.05)
    assert prior.FACET_SIGMA < np.sqrt(variance[2]) < 1.5 * prior.FACET_SIGMA
    assert mean[3] == 0.0 and mean[8] == 0.0  # another piece; gloss


@pytest.mark.parametrize("strength", [0.3, 30.0, 3e4])
def test_what_frames_have_told_of_each_is_found_again(strength):
    """Of a law whose frames told each facet by itself: marginal means and variances say what they told."""
    rng = np.random.default_rng(5)
    information, value = strength * rng.uniform(0.2, 1.5, 12), rng.normal(0, 0.5, 12)
    mean, covariance = brute(information, value)
    given = np.zeros((2, 12)), np.arange(12), mean, np.diag(covariance), OWN
    pull, told = FACETS.told_alone(*given)
    assert told == pytest.approx(information, rel=2e-2)
    assert pull == pytest.approx(information * value, rel=2e-2, abs=2e-2 * strength)


def test_dark_facets_keep_what_was_told_of_them():
    rng = np.random.default_rng(6)
    information, value = rng.uniform(1, 40, 12), rng.normal(0, 0.5, 12)
    mean, covariance = brute(information, value)
    lit = np.array([0, 2, 3, 5, 7])
    before = np.stack([value, information])
    variance = np.full(12, np.inf)
    variance[lit] = np.diag(covariance)[lit]
    pull, told = FACETS.told_alone(before, lit, mean, variance, OWN)
    dark = np.setdiff1d(np.arange(12), lit)
    assert np.array_equal(told[dark], information[dark])
    assert told[lit] == pytest.approx(information[lit], rel=2e-2)
    assert pull[lit] == pytest.approx((information * value)[lit], abs=0.3)


def test_pieces_of_one_facet_are_as_if_there_were_none():
    plain = facets_of(np.arange(4, dtype=np.int32), (4, 4))
    assert not plain.any and not facets_of(None, (4, 4)).any
    assert isinstance(plain, Facets) and plain.piece.tolist() == list(range(8))

"""A body of which a part lies where the frame tells nothing: beyond its edge, or where a sensor is full."""

from dataclasses import replace

import numpy as np
import pytest
from lit_body import QUALITY, SUN, VIEW, lit_body, pose, scene, seen, shares

from service.inference.model import existence, prior
from service.inference.model.likelihood import fit_light, t_log_density
from service.inference.model.scene import Scene
from service.inference.model.terms import terms_of
from service.inference.numerics.hill import Hill
from service.inference.numerics.priors import PosePrior

EDGE = 36  # row from which on nothing is known


def cut_scene(discrepancy: float) -> Scene:
    """The small body's frame, of which the lower part lies beyond the edge."""
    image = seen(pose(), shares(lit_body(), 900.0)) + np.random.default_rng(5).normal(0, 4.0, (VIEW.side,) * 2)
    unknown = np.zeros(image.shape, bool)
    unknown[EDGE:] = True
    given = scene(image, 4.0, low_pass=1.0, discrepancy=discrepancy)
    return replace(given, image=np.where(unknown, 0.0, image).astype(np.float32), unseen=unknown)


@pytest.mark.parametrize("discrepancy", [0.005, 0.05, 0.3])
def test_light_where_nothing_is_known_costs_nothing(discrepancy):
    """A body that goes on there is as likely as one that ends at the edge: its own noise there is no price."""
    drawn = lit_body().planes(pose(), SUN, VIEW, QUALITY)
    ending = drawn.copy()
    ending[:, :, EDGE + 6 :] = 0.0  # far enough for the point spread
    terms = terms_of(cut_scene(discrepancy), 3, 10)
    on, ends = (fit_light(one[0], 3, terms) for one in (drawn, ending))
    assert on.light[EDGE + 6 :].max() > 100.0
    assert on.log_evidence == pytest.approx(ends.log_evidence, abs=1.5)
    assert on.chi2 == pytest.approx(ends.chi2, rel=0.05)
    told = lit_body().light.evidence(np.concatenate([drawn, ending]), 3, terms, 6)
    assert told.log_evidence == pytest.approx([on.log_evidence, ends.log_evidence], abs=0.05)
    assert told.chi2 == pytest.approx([on.chi2, ends.chi2], rel=1e-2, abs=1e-3)


def test_of_a_least_value_more_is_as_likely_and_less_is_not():
    residual, variance, full = (
        np.array([0.0, 0.0, 3.0], np.float32),
        np.array([1.0, 100.0, 1.0], np.float32),
        np.ones(3),
    )
    at, wider, darker = t_log_density(residual, variance, full.astype(bool))
    assert at == wider == 0.0
    assert darker == pytest.approx(-2.5 * np.log1p(9 / 4))


def test_around_a_full_pixel_light_is_data_and_around_an_unseen_one_it_is_not():
    """Were all that is known around it a least value, a bright body could grow there at no cost."""
    none = np.zeros((VIEW.side,) * 2, bool)
    one = none.copy()
    one[20, 30] = True
    given = scene(none.astype(np.float32), 4.0, low_pass=1.0)
    full, unseen = replace(given, full=one), replace(given, unseen=one)
    np.testing.assert_array_equal(full.censored, one)
    assert not full.unknown.any() and unseen.unknown.sum() == 9
    np.testing.assert_array_equal(unseen.censored, unseen.unknown)
    assert not replace(given, full=0.4 * one).censored.any()


@pytest.mark.parametrize("nats", [50.0, 170.0, 5000.0])
def test_searches_meet_a_body_the_less_the_more_of_it_is_hidden(nats):
    assert existence.nats_of_search(nats, 0.0) == nats
    half, hidden = existence.nats_of_search(nats, 0.5), existence.nats_of_search(nats, 1.0)
    whole, *less = (1 / (1 + (prior.SEARCH_HALF / one) ** 2) for one in (nats, half, hidden))
    assert less == pytest.approx([(1 - 0.5 * prior.HIDDEN_MISSED) * whole, (1 - prior.HIDDEN_MISSED) * whole])
    assert existence.missed(1, nats=half) == pytest.approx(1 - less[0])


def test_the_hidden_share_of_a_bodys_light_is_that_beyond_the_edge():
    given, drawn = cut_scene(0.01), lit_body().planes(pose(), SUN, VIEW, QUALITY)
    hill = Hill(given, lit_body(), VIEW, PosePrior())
    fit = fit_light(drawn[0], 3, terms_of(given, 3, 10))
    whole = fit_light(drawn[0], 3, terms_of(replace(given, unseen=None), 3, 10))
    assert existence.hidden_share(hill, fit) == pytest.approx(fit.light[EDGE:].sum() / fit.light.sum(), abs=0.08)
    bright = replace(given, unseen=None, full=given.image > 0.8 * given.image.max())  # full, and seen
    assert existence.hidden_share(replace(hill, scene=bright), whole) == 0.0

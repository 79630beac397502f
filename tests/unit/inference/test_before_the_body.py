"""Frames before the body comes into view: what they show says nothing of it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from held_mixture import mixture
from test_light_filter import SIGMA, SIZE, Drawn, advance, error_deg, frame, given

from service.inference.filters.effort import is_doubted
from service.inference.filters.status import status_of, told_existence
from service.inference.filters.weighing import usual_of
from service.inference.model import existence, prior
from service.inference.state import FilterState
from service.workers.lit_frame import known_span, region_of


def star(k: int, x: float = 40.0) -> Drawn:
    """A faint one, drifting; nothing else."""
    image = np.random.default_rng(60 + k).normal(0, SIGMA, (SIZE, SIZE))
    image += 25.0 * np.exp(-0.5 * np.sum((np.mgrid[:SIZE, :SIZE].T - (x + k, 60.0)) ** 2, axis=2) / 1.3**2)
    return Drawn(image)


def test_a_star_that_was_there_first_does_not_keep_the_body_from_being_followed():
    """It is explained as a small, far body: of little light, and of little that is left over."""
    state = None
    for k in range(2):
        state, estimate = advance(state, star(k), k)
        assert estimate.status in ("no_fit", "no_target")
    for k in range(2, 4):
        light = frame(k)
        state, estimate = advance(state, Drawn(light._whole.image, known_px=known_span(state)), k)
        assert estimate.status == "tracking" and error_deg(estimate, k) < 3.0
    assert state.mixture.misses == 0  # of so little light searches meet nothing, so they have missed nothing


def test_light_that_may_have_been_anothers_says_so_much_less_of_the_bodys():
    law = np.exp([existence.log_of_change(5.0, now) for now in (5.0, 6.0, 9.0)])
    half = np.exp([existence.log_of_change(5.0, now, 0.5) for now in (5.0, 6.0, 9.0)])
    assert half == pytest.approx(0.5 * law + 0.5)
    assert existence.log_of_change(5.0, 50.0, 0.0) == 0.0
    assert existence.log_of_change(5.0, 50.0, 1 - prior.ANSWER_WRONG) == pytest.approx(np.log(prior.ANSWER_WRONG))


def test_a_level_that_may_be_anothers_has_the_moments_of_both_laws():
    level, prior_level = np.array([-0.6, 0.05]), existence.usual_chi2()
    draws = np.random.default_rng(0).normal(size=200_000)
    own = np.arange(len(draws)) % 4 < 3
    both = np.where(own, *(m + np.sqrt(v) * draws for m, v in (level, prior_level)))
    assert existence.level_if(level, 0.75) == pytest.approx([both.mean(), both.var()], abs=0.02)
    assert existence.level_if(level, 1.0) == pytest.approx(level)
    assert existence.level_if(level, 0.0) == pytest.approx(prior_level)


def test_what_was_learnt_counts_as_it_is_likely_that_it_was_this_body_whatever_is_between_now():
    clear, clouded = mixture(), mixture(existence=(0.0, 0.1, 0.9))
    assert usual_of(clouded, 0.0).answered == usual_of(clear, 0.0).answered > 0.9
    assert usual_of(replace(clear, searched_nats=10.0), 0.0).answered < 0.1
    assert usual_of(mixture(discrepancy=0.064), 0.0).answered < 0.1
    assert usual_of(mixture(searches=900), 0.0).answered == 1 - prior.ANSWER_WRONG
    assert usual_of(None, 0.0).log_light is None


@pytest.mark.parametrize(
    ("shares", "nats", "status"),
    [
        ((0.49, 0.5, 0.01), -2.0, "no_target"),  # no more is explained than of an empty sky
        ((0.0, 0.97, 0.03), 45.0, "no_fit"),  # something shows
        ((0.0, 0.97, 0.03), 3000.0, "tracking"),
    ],
)
def test_what_no_search_may_have_met_is_something_as_probably_as_anything_shows(shares, nats, status):
    held = replace(mixture(existence=shares), searched_nats=nats)
    assert status_of(held, (), given(frame(0), 0).domain) == status
    assert told_existence(held).sum() == pytest.approx(1.0) and (told_existence(held) >= 0).all()
    assert is_doubted(held) == (status != "tracking")  # and searched on, whatever it is told as


def test_while_it_is_doubted_the_body_may_be_anywhere_in_the_frame():
    held = replace(mixture(), searched_nats=3000.0)
    state = FilterState(held.poses, np.zeros(1), np.zeros((1, 6)), 0, 0.0, "tracking", {}, held)
    where = 0.1, 1.0, (400, 400)
    assert region_of(state, *where) is not None
    assert region_of(replace(state, mixture=replace(held, searched_nats=45.0)), *where) is None
    assert region_of(replace(state, mixture=replace(held, existence=np.array([0.0, 0.2, 0.8]))), *where) is None

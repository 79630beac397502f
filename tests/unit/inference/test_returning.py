"""An answer that something came before is followed unseen, and is back where it was expected (docs/model.md, 6)."""

from __future__ import annotations

import functools
from dataclasses import replace

import numpy as np
import pytest
import test_light_filter as lit
from held_mixture import mixture
from test_displaced import NOISE, predicted, turned

from service.inference.filters import mixture as filtering
from service.inference.filters.displaced import carried_on
from service.inference.filters.returning import as_it_was, is_back, waiting, with_displaced_mode
from service.inference.model import prior
from service.inference.pose import angle_between
from service.inference.state import Displaced, FilterState
from service.workers.codec import decode, encode


def known(probability: float = 0.99) -> Displaced:
    rates = np.array([[0.1, 0.0, 0.0, 0.0, 0.0, 0.0]])
    was = replace(mixture(searches=7, misses=1), poses=turned(2.0), rates=rates, paint=np.ones((1, 2, 6)))
    return Displaced(probability, turned(2.0), rates, was)


def test_a_displaced_answer_is_tried_behind_the_modes_while_it_is_likely_enough():
    held = predicted(mixture((0.7, 0.3)), known())
    ahead = with_displaced_mode(held)
    assert ahead.returning == 2 and len(ahead.poses) == len(ahead.paint) == len(ahead.suns) == 3
    assert np.exp(ahead.log_weights).sum() == pytest.approx(1.0)
    assert np.exp(ahead.log_weights[2] - ahead.log_weights[0]) == pytest.approx(prior.BIRTH)
    assert ahead.poses.quaternion[2] == pytest.approx(turned(2.0).quaternion[0])
    for other in (None, known(0.01), replace(known(), was=None)):
        assert with_displaced_mode(replace(held, displaced=other)).returning is None


def test_it_is_carried_on_unseen():
    on = carried_on(known(), NOISE, 2.0)
    assert np.rad2deg(angle_between(on.pose.quaternion, turned(2.2).quaternion)[0]) < 1e-6
    assert np.all(np.diag(on.was.covariance[0])[:3] > np.diag(known().was.covariance[0])[:3])
    assert np.all(on.was.paint[0, 1] < 1.0) and on.was.searches == 7
    assert carried_on(replace(known(), was=None), NOISE, 2.0).was is None


def test_it_is_back_with_all_that_was_known_of_it():
    before = replace(mixture(searches=2, misses=4, discrepancy=0.04), displaced=known(), since_search=5)
    ahead = with_displaced_mode(predicted(before, known()))
    leads, does_not = (type("Updated", (), {"log_weights": np.array(w)})() for w in ([-9.0, 0.0], [0.0, -9.0]))
    assert is_back(leads, ahead) and not is_back(does_not, ahead)
    was = as_it_was(before)
    assert (was.searches, was.misses, was.discrepancy, was.since_search) == (7, 1, 0.008, 5)
    assert was.displaced is before.displaced and was.existence is before.displaced.was.existence
    assert as_it_was(mixture()).displaced is None


def test_modes_wait_as_they_were_expected():
    before = mixture((0.6, 0.4))
    after = waiting(replace(before, searches=12), replace(predicted(before), poses=before.poses), before)
    assert after.searches == 12 and len(after.poses) == 2


def mirrored(k: int) -> lit.Drawn:
    light, across = lit.frame(k), round(2 * float(lit.truth(k).position[0, 0]) - lit.SIZE)
    light._whole = replace(light._whole, image=np.roll(light._whole.image[:, ::-1], across, axis=1))
    return light


@functools.cache
def glitch() -> tuple[tuple[FilterState, str, float], ...]:
    """Three frames, two that are mirrored, and another."""
    (state, _), told = lit.passed()[2], []
    for k in (3, 4, 5):
        state, estimate = lit.advance(state, mirrored(k) if k < 5 else lit.frame(k), k)
        told.append((state, estimate.status, lit.error_deg(estimate, k)))
    return tuple(told)


def test_after_mirrored_frames_the_body_is_where_it_was_expected_and_is_not_searched(monkeypatch):
    told = glitch()
    assert [status for _, status, _ in told[:2]] == ["lost", "lost"]
    displaced = told[1][0].mixture.displaced
    assert displaced.probability > 0.9
    assert np.rad2deg(angle_between(displaced.pose.quaternion, lit.truth(4).quaternion[0])[0]) < 3.0
    assert told[2][2] < 3.0 and told[2][0].mixture.displaced is None  # it is back
    monkeypatch.setattr(filtering, "search", lambda *look, **how: pytest.fail("a search"))
    state, estimate = lit.advance(told[1][0], lit.frame(5), 5)
    assert lit.error_deg(estimate, 5) < 3.0 and state.mixture.misses == 0
    monkeypatch.undo()  # what has come between may be there still
    for k in (6, 7, 8):
        state, estimate = lit.advance(state, lit.frame(k), k)
    assert estimate.status == "tracking"


def test_what_is_remembered_is_stored_bit_for_bit():
    state = glitch()[1][0]
    assert encode(decode(FilterState, encode(state))) == encode(state)

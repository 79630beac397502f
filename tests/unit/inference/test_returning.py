"""An answer that something came before is followed unseen, and is back where it was expected (docs/model.md, 6)."""

from __future__ import annotations

import functools
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import test_light_filter as lit
from held_mixture import mixture
from test_displaced import GIVEN, NOISE, predicted, turned

from service.inference.filters import mixture as filtering
from service.inference.filters.displaced import carried_on
from service.inference.filters.returning import (
    as_it_was,
    gone_by_now,
    is_back,
    leading_again,
    waiting,
    with_displaced_mode,
    within_reach,
)
from service.inference.model import prior
from service.inference.motion import motion_noise
from service.inference.pose import angle_between
from service.inference.state import Displaced, FilterState
from service.sessions.config import effective
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
    ahead, domain = with_displaced_mode(predicted(before, known())), GIVEN.domain

    def led(weights: list[float], *turns: float) -> SimpleNamespace:
        modes = [SimpleNamespace(pose=turned(by), covariance=np.eye(6)) for by in turns]
        return SimpleNamespace(log_weights=np.array(weights), refined=modes)

    assert is_back(led([-9.0, 0.0], 0.0, 2.0), ahead, domain) and not is_back(led([0.0, -9.0], 0.0, 2.0), ahead, domain)
    assert is_back(led([0.0, -9.0], 2.0, 2.0), ahead, domain)  # what leads has met it
    again = leading_again(ahead, 1, as_it_was(before), gone=0.25)
    assert np.argmax(again.log_weights) == 1 and np.exp(again.log_weights).sum() == pytest.approx(1.0)
    assert again.existence == pytest.approx([0.0, 0.25, 0.75])
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


def test_what_passes_in_a_moment_is_gone_sooner_than_what_has_lasted():
    lasted = [gone_by_now(replace(known(), since_s=since), False, 0.1) for since in (0.1, 0.2, 9.9)]
    assert lasted == pytest.approx([1 / 2, 1 / 3, 0.01])
    assert gone_by_now(known(), True, 0.1) == 1.0 and gone_by_now(known(), False, 0.0) == 0.0
    assert carried_on(replace(known(), since_s=0.3), NOISE, 0.1).since_s == pytest.approx(0.4)


def streaked(k: int) -> lit.Drawn:
    """A satellite's trail through the body."""
    light = lit.frame(k)
    down, across = np.mgrid[: lit.SIZE, : lit.SIZE] - lit.truth(k).position[0, ::-1, None, None]
    trail = 4000.0 * np.exp(-0.5 * ((0.6 * across - 0.8 * down - 3.0) / 1.5) ** 2)
    light._whole = replace(light._whole, image=light._whole.image + trail.astype(np.float32))
    return light


def test_what_came_before_a_body_that_stayed_where_it_was_expected_is_gone_at_once(monkeypatch):
    state, _ = lit.passed()[2]
    for k in (3, 4):
        state, estimate = lit.advance(state, streaked(k), k)
        assert estimate.status == "lost"
    assert state.mixture.displaced.probability > 0.9
    monkeypatch.setattr(filtering, "search", lambda *look, **how: pytest.fail("a search"))
    state, estimate = lit.advance(state, lit.frame(5), 5)
    assert estimate.status == "tracking" and lit.error_deg(estimate, 5) < 3.0 and state.mixture.displaced is None


def test_a_body_that_was_not_seen_for_some_frames_is_looked_for_where_it_is_expected(monkeypatch):
    """Dropped frames, black ones: nothing is told by them that the next could repeat, so nothing of it fades."""
    state, noise = lit.passed()[5][0], motion_noise(effective({}).motion, GIVEN.domain)
    assert within_reach(filtering.predict(state.mixture, noise, lit.DT_S))
    assert not within_reach(filtering.predict(state.mixture, noise, 600.0))
    monkeypatch.setattr(filtering, "search", lambda *look, **how: pytest.fail("a search"))
    _, estimate = lit.advance(state, lit.frame(6), 6)
    assert estimate.status == "tracking" and lit.error_deg(estimate, 6) < 3.0


def test_what_is_remembered_is_stored_bit_for_bit():
    state = glitch()[1][0]
    assert encode(decode(FilterState, encode(state))) == encode(state)

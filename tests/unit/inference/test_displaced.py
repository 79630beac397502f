"""An answer that another displaced: a body does not turn under a cloud, so either is wrong (docs/model.md, 6)."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import test_light_filter as lit
from held_mixture import HELD, mixture

from service.inference.articulation import Articulation
from service.inference.domain import Domain
from service.inference.filters.displaced import carried_on, turns_there, was_right, with_displaced
from service.inference.filters.given import Predicted
from service.inference.filters.status import told_existence
from service.inference.model import prior
from service.inference.model.existence import expected
from service.inference.motion import motion_noise
from service.inference.params import PriorParams
from service.inference.pose import angle_between, retract
from service.inference.state import Displaced
from service.inference.symmetry import Symmetry
from service.sessions.config import effective

GIVEN = SimpleNamespace(twins=(), domain=Domain(144, 144, 1.0, Articulation(()), PriorParams()))
WIDE = 1e-4 * np.eye(6)  # rad^2: the prediction is known to half a degree
NOISE = motion_noise(effective({}).motion, GIVEN.domain)
HALF_TURN = Symmetry(((1.0, 0.0, 0.0), (0.0, -1.0, 0.0), (0.0, 0.0, -1.0)))


def turned(by: float, about: int = 0):
    step = np.zeros((1, 6))
    step[0, about] = by
    return retract(HELD, step)


def predicted(held, displaced: Displaced | None = None) -> Predicted:
    return Predicted(
        held.poses,
        held.rates,
        held.covariance,
        held.suns,
        held.sun_sigmas,
        held.paint,
        held.log_weights,
        expected(held.existence, 0.1),
        displaced,
    )


def leads(pose, before, disturbed: float, displaced: Displaced | None = None, fits: float = 0.99):
    """The mixture after a frame in which ``pose`` leads."""
    after = replace(mixture(existence=(0.0, fits, 1 - fits), searches=4, ever=True), poses=pose)
    return with_displaced(after, before, predicted(before, displaced), disturbed, GIVEN)


def test_whether_the_old_answer_or_the_new_one_is_right():
    surely = was_right(answered=1.0, disturbed=1.0, moved=0.0)
    assert surely == pytest.approx(1 - prior.ANSWER_WRONG)
    assert was_right(answered=1.0, disturbed=0.0, moved=0.0) == 0.0  # nothing has come between: it was wrong
    assert was_right(answered=0.6, disturbed=0.01, moved=0.0) < 0.02  # it was as good as another
    assert was_right(answered=0.9, disturbed=0.9, moved=0.0) == pytest.approx(0.81 / 0.91)
    assert was_right(answered=1.0, disturbed=1.0, moved=1e3) < 1e-2  # it has turned there


def test_a_body_turns_as_far_as_it_is_expected_to():
    near, far = (turns_there(HELD, WIDE, turned(by), GIVEN) for by in (0.005, 3.0))
    assert near > 1e4 and far < 1e-4
    nothing_known = turns_there(HELD, 4.0 * np.eye(6), turned(3.0), GIVEN)
    assert 0.1 < nothing_known < 10.0
    twins = SimpleNamespace(twins=(HALF_TURN,), domain=GIVEN.domain)
    assert turns_there(HELD, WIDE, turned(np.pi), twins) == pytest.approx(
        turns_there(HELD, WIDE, HELD, GIVEN), rel=1e-6
    )


def test_what_has_come_between_goes_away_and_the_body_turns_on_behind_it():
    rates = np.zeros((1, 6))
    rates[0, 0] = 0.1
    held = carried_on(Displaced(0.99, HELD, rates), NOISE, 5.0)
    assert np.rad2deg(angle_between(held.pose.quaternion, turned(0.5).quaternion)[0]) < 1e-6
    odds = held.probability / (1 - held.probability)
    assert odds == pytest.approx(99 * np.exp(-5 * prior.CHANGES_PER_S))
    assert carried_on(None, NOISE, 1.0) is None


def test_an_answer_far_from_one_that_was_sure_is_not_believed_where_something_has_come_between():
    before = replace(mixture(ever=True), answered=1.0)
    after = leads(turned(2.0), before, disturbed=1.0)
    assert after.displaced is not None and after.displaced.probability > 0.99 and after.answered == 0.0
    assert told_existence(after)[2] > 0.99
    undisturbed = leads(turned(2.0), before, disturbed=1e-4)
    assert told_existence(undisturbed)[1] > 0.9 * told_existence(replace(undisturbed, displaced=None))[1]
    unsure = leads(turned(2.0), replace(before, answered=0.3), disturbed=0.05)
    assert unsure.displaced.probability < 0.05 and unsure.answered > 0.5


def test_the_answer_that_was_displaced_is_known_again():
    held = Displaced(0.99, turned(2.0), np.zeros((1, 6)))
    before = replace(mixture(ever=True), answered=0.005, displaced=held)
    assert leads(turned(2.03), before, 1.0, held).displaced is None
    other = leads(turned(1.0), before, 1.0, held)  # a third answer is not the first one
    assert other.displaced is held
    assert leads(HELD, before, 0.0, held).displaced is held  # nor is the one that displaced it


def test_an_answer_is_remembered_through_a_frame_that_drags_its_mode_away_and_that_nothing_fits():
    before = replace(mixture(ever=True), answered=1.0)
    dragged = leads(turned(0.15), before, disturbed=1.0, fits=1e-6)  # 9 degrees, well within the law's tails
    assert dragged.displaced is not None and dragged.displaced.probability > 0.99
    assert dragged.answered == 0.0
    elsewhere = leads(turned(2.0), dragged, disturbed=1.0, displaced=dragged.displaced)
    assert told_existence(elsewhere)[2] > 0.95  # a mirrored image, say
    turned_on = leads(turned(0.2), dragged, disturbed=1.0, displaced=dragged.displaced)
    assert turned_on.displaced.probability < 0.1  # it has turned that far, and fits again
    back = leads(turned(0.01), dragged, disturbed=1.0, displaced=dragged.displaced)
    assert back.displaced is None


def test_where_something_comes_before_it_an_answer_is_kept_as_it_was_expected():
    before = replace(mixture(ever=True), answered=0.97)
    covered = leads(turned(0.02), before, disturbed=1.0, fits=0.1)  # still where it was
    assert covered.displaced.probability == pytest.approx(0.97 * 0.9) and covered.answered == 0.97
    assert covered.displaced.pose.quaternion == pytest.approx(HELD.quaternion)
    elsewhere = leads(turned(2.0), covered, disturbed=1.0, displaced=covered.displaced)
    assert elsewhere.displaced.was is covered.displaced.was
    again = leads(turned(0.02), covered, disturbed=1.0, displaced=covered.displaced, fits=0.1)
    assert again.displaced is covered.displaced  # what came before it is there still
    assert again.answered == pytest.approx(covered.displaced.probability)
    clear = leads(turned(0.02), covered, disturbed=1.0, displaced=covered.displaced)
    assert clear.displaced is None and clear.answered > 0.9


def test_unseen_it_may_turn_anywhere():
    before = replace(mixture(existence=(0.9, 0.1, 0.0), ever=True), answered=1.0)
    assert leads(turned(2.0), before, disturbed=1.0).displaced is None


def test_what_a_leader_is_told_with_is_kept_while_it_does_not_fit():
    told = leads(HELD, mixture(ever=True), 0.0)
    assert told.answered == pytest.approx(told_existence(told)[1])
    before = replace(mixture(ever=True), answered=0.97)
    covered = replace(mixture(existence=(0.0, 0.1, 0.9), ever=True), poses=HELD)
    assert with_displaced(covered, before, predicted(before), 0.0, GIVEN).answered == 0.97


def test_a_wrong_answer_that_explained_its_frames_by_its_discrepancy_does_not_outlive_a_better_one():
    """Under the discrepancy of the truth it explains nothing, as if something had come between."""
    state, turn = lit.passed()[2][0], 0.6 * np.eye(6)[1:2]
    wrong = replace(
        state.mixture,
        poses=retract(state.mixture.poses, turn),
        paint=0 * state.mixture.paint,
        discrepancy=0.1,
        log_discrepancy=None,
        log_chi2=np.array([0.1, 0.05]),
        answered=0.9,
        searches=0,
    )
    state, estimate = lit.advance(replace(state, mixture=wrong), lit.frame(3), 3)
    assert lit.error_deg(estimate, 3) < 3.0 and state.mixture.discrepancy < 0.02
    assert state.mixture.displaced is None and estimate.status == "tracking"


def test_where_a_frame_dragged_it_an_answer_is_not_remembered_instead_of_where_it_was():
    kept = Displaced(0.9, turned(0.2), np.zeros((1, 6)))
    for fits, place in ((0.003, turned(0.2)), (0.9, HELD)):  # what explained its last frame is an answer of its own
        before = replace(mixture(existence=(0.0, fits, 1 - fits), ever=True), answered=0.998, displaced=kept)
        after = leads(turned(2.0), before, disturbed=1.0, displaced=kept, fits=0.1)
        assert after.displaced.pose.quaternion == pytest.approx(place.quaternion)

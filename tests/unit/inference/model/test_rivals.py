"""A search that goes on over frames: each part meets what is better than a track, and nothing beside the truth."""

from dataclasses import replace

import numpy as np
import pytest
from lit_search import TOLD, bank, body, followed, off_deg, sight_of, truth

from service.inference.model import rivals as looking
from service.inference.model.proposing import propose, turns
from service.inference.model.rivals import rivals
from service.inference.model.search import most_parts
from service.inference.model.stages import WHOLE, Part
from service.inference.numerics.priors import PosePrior
from service.inference.pose import retract

pytestmark = pytest.mark.usefixtures("small_banks")
PARTS = [Part(number, 4) for number in range(4)]


def met(at, modes, part, jointed=False):
    given = body(jointed), followed(sight_of(at), modes), bank(jointed), TOLD
    return rivals(*given, part, np.random.default_rng(part.number))


def test_parts_have_all_templates_between_them_and_a_share_of_the_work():
    numbers = np.arange(11)
    assert sorted(np.concatenate([numbers[part.own] for part in PARTS])) == numbers.tolist()
    assert [part.is_last for part in PARTS] == [False, False, False, True] and WHOLE.is_last
    assert (WHOLE.share(1), WHOLE.share(24)) == (1, 24)
    assert [PARTS[0].share(count) for count in (1, 7, 8, 9, 24)] == [2, 2, 2, 3, 6]


def test_parts_propose_templates_of_their_own():
    sight = sight_of(truth(4, False))
    patch = sight.cut(sight.span, 28.0)
    proposed = [propose(bank(False), patch, TOLD, part) for part in PARTS]
    turned = [{tuple(one) for one in np.round(some.poses.quaternion, 9)} for some in proposed]
    assert all(turned) and not any(a & b for k, a in enumerate(turned) for b in turned[:k])
    assert max(len(some) for some in proposed) <= 5 * 20  # kinds, each with a fourth of its eighty


def test_where_no_sun_is_told_the_ways_to_turn_the_frame_are_shared():
    assert turns(4500, TOLD) == 1 and turns(4500, PosePrior()) == 16
    assert most_parts(body(False), PosePrior()) == turns(len(bank(False).poses), PosePrior())
    assert most_parts(body(False), TOLD) == len(bank(False).poses)


@pytest.mark.parametrize("away", [0.6, 2.0])
def test_some_part_meets_the_truth_beside_a_track_that_is_wrong(away):
    at = truth(4, False)
    best = [one for part in PARTS for one in met(at, retract(at, away * np.eye(6)[1:2]), part)[:1]]
    best.sort(key=lambda one: -one.log_posterior)
    assert off_deg(best[0].pose, at) < 2.0
    assert np.isfinite(best[0].covariance).all()


def test_beside_the_truth_nothing_is_met_and_nothing_climbs_to_the_finest_patch(monkeypatch):
    monkeypatch.setattr(looking, "ascend", lambda *given, **how: pytest.fail("went on"))
    at = truth(4, False)
    assert [met(at, retract(at, 0.01 * np.eye(6)[:1]), part) for part in PARTS] == [[]] * 4


def test_symmetry_equivalents_of_what_is_met_are_looked_at_too():
    at = truth(4, False)
    wrong = retract(at, 0.6 * np.eye(6)[1:2])
    asked = []

    def alike(poses):
        asked.append(len(poses))
        return poses

    given = body(False), followed(sight_of(at), wrong), bank(False), TOLD
    some = [rivals(*given, part, np.random.default_rng(part.number), alike) for part in PARTS]
    assert asked and min(asked) > 0
    assert min(off_deg(one.pose, at) for part in some for one in part) < 2.0


def test_a_joint_that_is_wrong_makes_another_look():
    at = truth(4, True)
    wrong = replace(at, joints=(at.joints + 60.0 + 180.0) % 360.0 - 180.0)
    best = [one for part in PARTS for one in met(at, wrong, part, jointed=True)[:1]]
    assert min(off_deg(one.pose, at) for one in best) < 3.0

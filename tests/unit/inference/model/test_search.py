"""A frame of which nothing is known: a pose is found from templates alone, and the parts of the way there."""

from dataclasses import replace

import numpy as np
import pytest
from lit_body import SUN, lit_body
from lit_search import (
    TOLD,
    bank,
    body,
    dark_sight,
    half_turns,
    is_ordered,
    off_deg,
    rough_hill,
    sight_of,
    track_at,
    truth,
)

from service.imaging.patch import Patch
from service.inference.model import search as searching
from service.inference.model.candidates import Candidates, best_of, distinct, log_prior, scored
from service.inference.model.nuisance import Nuisance, best_spread
from service.inference.model.search import finest_hill, make_bank, search, varied
from service.inference.model.shaking import shaken
from service.inference.model.stages import FINEST, Sight, stage_hill
from service.inference.model.templates import Bank
from service.inference.numerics.gauss_newton import ascend
from service.inference.numerics.hill import looked
from service.inference.numerics.priors import PosePrior
from service.inference.pose import exp_so3, retract
from service.inference.state import Poses

pytestmark = pytest.mark.usefixtures("small_banks")


@pytest.mark.parametrize(("seed", "scale_told"), [(2, False), (4, True)])
def test_a_pose_is_found_from_nothing(seed, scale_told):
    at = truth(seed, False)
    told = PosePrior(float(at.log_scale[0]), 0.03, SUN) if scale_told else TOLD
    found = search(body(False), sight_of(at), bank(False), told)
    best = found.basins[0]
    assert off_deg(best.pose, at) < 2.0
    assert np.abs(best.pose.position - at.position).max() < 0.5
    assert abs(best.pose.log_scale[0] - at.log_scale[0]) < 0.02
    assert best.log_posterior > max((one.log_posterior for one in found.basins[1:]), default=-np.inf) + 10.0
    assert is_ordered(found) and 1 <= len(found.basins) <= FINEST.kept + 2
    assert found.nuisance.core == pytest.approx(1.3, rel=0.35) and found.nuisance.wings == 0.0
    assert found.hill.scene.discrepancy == found.nuisance.discrepancy < Nuisance(1.0).discrepancy


def test_a_large_body_is_found_on_squares_of_pixels_some_of_them_outside_of_the_frame():
    at = replace(truth(5, False, rim_px=82.0), position=np.array([[88.0, 88.0]]))
    found = search(body(False), sight_of(at, 176), bank(False), TOLD)
    assert 1.2 < found.hill.view.binning < 2.0 and found.hill.scene.unknown.mean() > 0.3
    assert off_deg(found.basins[0].pose, at) < 2.0
    assert np.abs(found.basins[0].pose.position - at.position).max() < 0.5


def test_a_wider_sight_proposes_too_and_evidence_says_which():
    """Of a body of which one place alone was taken for all."""
    at = truth(4, False)
    whole = sight_of(at)
    found = search(body(False), replace(whole, span=0.3 * whole.span), bank(False), TOLD, whole)
    assert off_deg(found.basins[0].pose, at) < 2.0


def test_a_sight_in_which_no_template_is_met_leaves_the_search_to_the_other():
    at = truth(4, False)
    whole, dark = sight_of(at), dark_sight()
    narrow, wide = replace(dark, span=0.5 * whole.span), replace(dark, span=1.5 * whole.span)
    for pair in ((narrow, whole), (whole, wide)):
        assert off_deg(search(body(False), pair[0], bank(False), TOLD, pair[1]).basins[0].pose, at) < 2.0
    assert search(body(False), narrow, bank(False), TOLD, wide).basins == []


def test_what_lies_around_the_best_can_be_left_to_a_later_search(monkeypatch):
    monkeypatch.setattr(searching, "shaken", lambda *given: pytest.fail("looked at"))
    at = truth(4, False)
    assert off_deg(search(body(False), sight_of(at), bank(False), TOLD, shake=False).basins[0].pose, at) < 2.0


def test_a_track_that_nothing_comes_near_ends_the_search_before_its_finest_stages(monkeypatch):
    monkeypatch.setattr(searching, "finished", lambda *given: pytest.fail("went on"))
    at = truth(4, False)
    near = retract(at, 0.03 * np.eye(6)[:1])
    found = search(body(False), sight_of(at), bank(False), TOLD, shake=False, track=track_at(near))
    assert found.basins == []


def test_a_track_that_is_wrong_is_bettered_by_the_truth():
    at = truth(4, False)
    for away in (0.6, 2.0):
        wrong = retract(at, away * np.eye(6)[1:2])
        found = search(body(False), sight_of(at), bank(False), TOLD, shake=False, track=track_at(wrong))
        assert off_deg(found.basins[0].pose, at) < 2.0


def test_a_track_is_shaken_though_the_templates_missed_it(monkeypatch):
    at = truth(4, False)
    few = Bank(bank(False).suns[:9], bank(False).poses[:9], bank(False).pictures[:, :9])
    shaken_poses = []
    monkeypatch.setattr(searching, "shaken", lambda clear, hill, one, doubted: shaken_poses.append(one.pose) or [])
    found = search(body(False), sight_of(at), few, TOLD, track=track_at(at))
    assert off_deg(found.basins[0].pose, at) < 2.0
    assert off_deg(shaken_poses[0], at) < 2.0


@pytest.mark.parametrize(("axis", "away"), [(0, 0.5), (1, 0.8), (2, 0.7)])
def test_about_a_track_that_is_doubted_the_truth_is_met_though_the_templates_missed_it(axis, away):
    at = truth(4, False)
    few = Bank(bank(False).suns[:9], bank(False).poses[:9], bank(False).pictures[:, :9])
    wrong = track_at(retract(at, away * np.eye(6)[axis : axis + 1]))
    given = body(False), sight_of(at), few, TOLD, None, np.random.default_rng(1)
    known = [off_deg(one.pose, at) for one in search(*given, shake=False, track=wrong).basins]
    assert min(known, default=180.0) > 20.0
    assert off_deg(search(*given, shake=False, track=replace(wrong, doubted=True)).basins[0].pose, at) < 2.0


def test_a_sight_that_is_hardly_wider_is_not_looked_at():
    def never(centre: tuple[float, float], span: float, wanted: float) -> Patch:
        raise AssertionError

    dark = dark_sight()
    wide = Sight(never, dark.centre, 1.2 * dark.span, 1.1)
    assert search(body(False), dark, bank(False), TOLD, wide).basins == []
    known = PosePrior(np.log(20.0), 0.03, SUN)  # nor is one where the size is told
    assert search(body(False), dark, bank(False), known, replace(wide, span=400.0)).basins == []


def test_a_basin_beside_the_truth_is_left_by_shaking_and_the_truth_is_not():
    at = replace(truth(4, True), joints=np.array([[179.0]]))
    hill = rough_hill(sight_of(at))
    beside = retract(at, 0.35 * np.eye(7)[1:2])
    one = ascend(hill, beside, SUN[None], steps=1, covariance="last")[0]
    best = max(shaken(hill, hill, one, doubted=True), key=lambda found: found.log_posterior)
    assert best.log_posterior > one.log_posterior + 1.0
    assert off_deg(best.pose, at)[0] < off_deg(one.pose, at)[0]
    assert abs(best.pose.joints[0, 0]) <= 180.0
    top = ascend(hill, best.pose, best.sun[None], steps=20, covariance="last")[0]
    assert all(found.log_posterior < top.log_posterior + 1.0 for found in shaken(hill, hill, top, doubted=True))


def test_joints_are_found_with_it():
    at = truth(4, True)
    best = search(body(True), sight_of(at), bank(True), TOLD).basins[0]
    assert off_deg(best.pose, at) < 3.0
    assert half_turns(best.pose, at) < 5.0


def test_a_panel_that_is_far_off_is_found_by_turning_it():
    at = truth(4, True)
    hill = rough_hill(sight_of(at))
    off = replace(at, joints=at.joints + 62.0)
    one = ascend(hill, off, SUN[None], steps=1, covariance="last")[0]
    best = max(shaken(hill, hill, one), key=lambda found: found.log_posterior)
    assert half_turns(one.pose, at) > 20.0
    assert half_turns(best.pose, at) < 12.0  # to about its sigma


def test_two_joint_values_of_one_rotation_both_go_on():
    """A dark panel seen well, or a bright one turned away: the first stages cannot tell, the last can by 19 nats."""
    at = truth(3, True)
    best = search(body(True), sight_of(at), bank(True), TOLD).basins[0]
    assert half_turns(best.pose, at) < 5.0


def test_a_frame_without_light_has_no_basins():
    for told in (TOLD, PosePrior(np.log(20.0), 0.03, SUN)):
        found = search(body(False), dark_sight(), bank(False), told)
        assert found.basins == []
        assert found.nuisance.core == 1.1


def test_a_told_scale_makes_the_patch_large_enough_for_the_whole_body():
    """Little of it may be lit."""
    spans: list[float] = []
    dark = dark_sight()

    def counted(centre: tuple[float, float], span: float, wanted: float) -> Patch:
        spans.append(span)
        return dark.cut(span, wanted)

    for rim_px, least in ((26.0, 40.0), (60.0, 70.0)):
        told = PosePrior(float(np.log(rim_px / lit_body().radius)), 0.03, SUN)
        search(body(False), replace(dark, patch=counted), bank(False), told)
        assert least <= min(spans) and max(spans) < 2 * 60.0
        spans.clear()


@pytest.mark.parametrize("jointed", [False, True])
def test_a_bank_stands_under_the_sun_that_is_told_or_under_all(jointed, monkeypatch):
    monkeypatch.setattr(searching, "BANK_SIZE", 40)
    count = 80 if jointed else 40
    told, free = make_bank(body(jointed), TOLD), make_bank(body(jointed), PosePrior())
    assert told.suns == pytest.approx(np.tile(SUN, (count, 1)))
    assert free.suns.shape == (count, 3) and np.linalg.norm(free.suns, axis=1) == pytest.approx(1.0)
    assert np.abs(free.suns.mean(axis=0)).max() < 0.2


def test_templates_are_as_many_as_joints_ask_for():
    assert [searching.bank_size(n) for n in (0, 1, 2, 9)] == [1500, 3000, 4500, 4500]


def candidates(turns: np.ndarray, found: np.ndarray) -> Candidates:
    """Poses turned about one axis (deg)."""
    n = len(turns)
    quaternion = exp_so3(np.deg2rad(turns)[:, None] * np.array([[0.6, 0.0, 0.8]]))
    poses = Poses(quaternion, np.zeros((n, 2)), np.zeros(n), np.arange(n, dtype=float)[:, None])
    return Candidates(poses, np.tile(SUN, (n, 1)), found)


def test_poses_near_one_before_them_are_not_distinct():
    turns = np.array([0.0, 3.0, 6.0, 10.0, 359.0, 180.0])
    poses = candidates(turns, np.zeros(6)).poses
    assert distinct(poses, np.deg2rad(5.0)).tolist() == [0, 2, 5]  # 3 degrees is near the first, 10 near 6
    assert distinct(poses, np.deg2rad(0.5)).tolist() == [0, 1, 2, 3, 4, 5]
    same = replace(poses, quaternion=poses.quaternion * np.array([[1.0], [-1]] * 3))
    assert distinct(same, np.deg2rad(5.0)).tolist() == [0, 2, 5]
    assert len(distinct(poses[np.array([], dtype=np.intp)], 0.1)) == 0


def test_the_best_of_each_basin_come_best_first():
    some = candidates(np.array([0.0, 2.0, 50.0, 51.0, 120.0]), np.array([-5.0, -3.0, -9.0, -8.0, -np.inf]))
    kept = best_of(some, 5)
    assert kept.found.tolist() == [-3.0, -8.0, -np.inf]
    assert kept.poses.joints[:, 0].tolist() == [1.0, 3.0, 4.0]
    assert best_of(some, 1).found.tolist() == [-3.0]


def test_poses_turned_alike_are_basins_of_their_own_where_their_joints_differ():
    turns = np.array([0.0, 1.0, 2.0, 3.0, 4.0, 1.0, 90.0])
    some = candidates(turns, -np.arange(7.0))
    panel = replace(some.poses, joints=np.array([[0.0], [30.0], [10.0], [-170.0], [-100.0], [100.0], [0.0]]))
    some = replace(some, poses=panel)
    joint = replace(lit_body().articulation.joints[0], minimum=-180.0, maximum=180.0)
    articulation = replace(lit_body().articulation, joints=(joint,))
    kept = best_of(some, 7, articulation).poses.joints[:, 0].tolist()
    assert kept == [0.0, 30.0, -170.0, -100.0, 0.0]  # 10 degrees is near 0; four at the most are turned alike
    assert best_of(some, 7).poses.joints[:, 0].tolist() == [0.0, 0.0]
    around = replace(some, poses=replace(panel, joints=np.array([[-175.0], [175.0], *[[0.0]] * 5])))
    assert best_of(around, 7, articulation).found.tolist() == [0.0, -2.0, -6.0]  # 10 degrees, the other way round


def test_what_is_scored_comes_best_first_with_its_own_pose():
    at = truth(4, True)
    others = Poses(*(np.repeat(part, 3, axis=0) for part in (at.quaternion, at.position, at.log_scale, at.joints)))
    others = replace(others, position=others.position + np.array([[9.0, 0], [0, 0], [3.0, 0]]))
    told = PosePrior(float(at.log_scale[0]) + 0.06, 0.03, SUN)
    hill = rough_hill(sight_of(at))
    suns, nothing = np.tile(SUN, (3, 1)), np.full(3, -np.inf)
    found = scored(hill, Candidates(others, suns, nothing))
    assert found.poses.position[:, 0] - at.position[0, 0] == pytest.approx([0.0, 3.0, 9.0])
    assert (np.diff(found.found) < 0).all()
    known = scored(replace(hill, told=told), Candidates(others, suns, nothing))
    assert known.found == pytest.approx(found.found - 2.0)
    assert log_prior(others, suns, told) == pytest.approx(-2.0)


def test_other_joint_values_are_tried():
    at = truth(4, True)
    start = replace(at, joints=at.joints + 70.0)
    hill = rough_hill(sight_of(at))
    some = scored(hill, Candidates(start, SUN[None], np.array([-np.inf])))
    tried = varied(hill, some)
    assert len(tried.found) == 1 + 8
    best = best_of(tried, 1)
    assert half_turns(best.poses, at) < 23.0
    assert best.found[0] > some.found[0] + 10.0
    assert ((tried.poses.joints >= -180) & (tried.poses.joints <= 250)).all()


def test_other_suns_are_tried_where_none_is_told():
    at = truth(4, True)
    hill = rough_hill(sight_of(at), PosePrior())
    assert hill.sun_free and not rough_hill(sight_of(at)).sun_free
    some = scored(hill, Candidates(at, -SUN[None], np.array([-np.inf])))
    best = best_of(varied(hill, some), 1)
    assert best.found[0] > some.found[0] + 4.0
    assert best.suns[0] @ SUN > 0.5


@pytest.mark.parametrize("first", [0.4, 4.0])
def test_the_point_spread_is_found_under_the_noise_that_there_is(first):
    """A frame without photon noise or discrepancy, of which the priors expect much."""
    at = truth(2, False)
    start = Nuisance(first, discrepancy=0.05)
    given = body(False), sight_of(at), Candidates(at, SUN[None], np.zeros(1))
    hill = stage_hill(body(False).fine, given[1], FINEST, start, TOLD, speckle=True)
    lead = looked(hill, at, SUN[None])
    found, nuisance = finest_hill(*given, lead, start, TOLD)
    again = best_spread(looked(found, at, SUN[None]), nuisance)
    assert again == nuisance
    assert nuisance.point_spread(1.0).width == pytest.approx(1.3, rel=0.25)

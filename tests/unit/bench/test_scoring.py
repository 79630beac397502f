"""Errors modulo what no silhouette tells, against hand-made answers and against the public evaluator."""

import json
import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import t as t_law

from service.bench.scoring import Referee, region_of
from service.inference.model.prior import POSE_DEGREES_OF_FREEDOM
from service.inference.numerics.student import draw
from service.inference.pose import exp_so3, from_matrices, multiply, rotation_matrices
from service.inference.state import Poses
from service.inference.symmetry import twin

MIRROR = np.diag([1.0, -1.0, 1.0])


def turned(quaternion, degrees):
    return multiply(quaternion, exp_so3(np.deg2rad(degrees) * np.array([0.6, 0.0, 0.8])))


def mirrored(quaternion, plane=MIRROR):
    return from_matrices(np.diag([1.0, 1.0, -1.0]) @ rotation_matrices(quaternion) @ plane)


def test_a_known_error_comes_out(case_of, satellite, truth, answer):
    referee = Referee(case_of(satellite))
    real = referee.draw(truth.poses(referee.articulation))
    found = answer((turned(truth.quaternion, 3.0), truth.position + np.array([3.0, 4.0]), 12.6, []), spread_deg=2.0)
    score = referee.score(7, truth, real, found, 12.5)
    assert (score.index, score.time_s, score.status, score.ms) == (7, 0.5, "tracking", 12.5)
    assert score.orientation_deg == pytest.approx(3.0)
    assert score.ratio == pytest.approx(1.5)
    assert score.position_px == pytest.approx(5.0)
    assert score.scale_percent == pytest.approx(5.0)
    assert 0.3 < score.iou < 0.95
    assert score.twins_reported is None
    exact = answer((truth.quaternion, truth.position, 12.0, []))
    assert referee.score(7, truth, real, exact, 1.0).iou == 1.0


def test_a_mirror_twin_is_no_error_and_both_sides_are_asked_for(case_of, block, truth, answer):
    referee = Referee(case_of(block))
    real = referee.draw(truth.poses(referee.articulation))
    itself = (truth.quaternion, truth.position, 12.0, [])
    other = (mirrored(turned(truth.quaternion, 2.0)), truth.position, 12.0, [])
    alone = referee.score(0, truth, real, answer(other), 1.0)
    both = referee.score(0, truth, real, answer(other, itself), 1.0)
    assert alone.orientation_deg == pytest.approx(2.0, abs=1e-4)
    assert (alone.twins_reported, both.twins_reported) == (False, True)
    assert (both.modes_deg, both.n_modes) == (pytest.approx(0.0, abs=1e-4), 2)


def test_listed_symmetries_take_the_place_of_the_models_own(case_of, block, truth, answer):
    found = answer((mirrored(truth.quaternion), truth.position, 12.0, []))
    for listed, right in (((), False), ((MIRROR,), True)):
        referee = Referee(case_of(block, symmetries=listed))
        score = referee.score(0, truth, referee.draw(truth.poses(referee.articulation)), found, 1.0)
        assert (score.orientation_deg < 1e-4) is right


def test_a_mode_of_little_weight_is_not_reported(case_of, satellite, truth, answer):
    referee = Referee(case_of(satellite))
    real = referee.draw(truth.poses(referee.articulation))
    poses = [(turned(truth.quaternion, angle), truth.position, 12.0, []) for angle in (20.0, 1.0)]
    for weight, nearest in ((0.2, 1.0), (0.05, 20.0)):
        score = referee.score(0, truth, real, answer(*poses, weights=[1 - weight, weight]), 1.0)
        assert score.modes_deg == pytest.approx(nearest)


def test_a_joint_one_turn_on_is_the_same_place(case_of, satellite, truth, answer):
    true = replace(truth, joints={"wing": 170.0})
    referee = Referee(case_of(satellite, free=("wing",)))
    found = answer((true.quaternion, true.position, 12.0, [-185.0]))
    score = referee.score(0, true, referee.draw(true.poses(referee.articulation)), found, 1.0)
    assert score.joint == pytest.approx(5.0)
    assert score.iou > 0.8


@pytest.mark.parametrize(("off", "within"), [(0.99, 1.0), (1.01, 0.0)])
def test_a_joint_is_held_against_the_interval_that_its_mode_states(case_of, satellite, truth, answer, off, within):
    """Of a Student t with 4 degrees of freedom and a deviation of 2: t quantile times the scale."""
    half = t_law.ppf(0.95, POSE_DEGREES_OF_FREEDOM) * 2.0 * np.sqrt(0.5)
    true = replace(truth, joints={"wing": 40.0})
    referee = Referee(case_of(satellite, free=("wing",)))
    real = referee.draw(true.poses(referee.articulation))
    found = answer((true.quaternion, true.position, 12.0, [40.0 + off * half]), joint_deg=2.0)
    assert referee.score(0, true, real, found, 1.0).joints90 == within


def test_a_frame_without_the_body_has_no_errors(case_of, satellite, truth, answer):
    found = answer((truth.quaternion, truth.position, 12.0, []))
    score = Referee(case_of(satellite)).score(3, truth, None, found, 1.0)
    assert not score.visible
    assert math.isnan(score.orientation_deg)
    assert math.isnan(score.iou)


def test_the_public_evaluator_agrees(evaluator, shared, shelf, case_of, answer, truth):
    """Same angle, same silhouette, same overlap as ../shared/tools/evaluate.py, mirror planes included."""
    file = shared / "data" / "meshes" / "shuttle_orbiter_lod.glb"
    model = shelf.model(file.name, file.read_bytes())
    listed = [np.array(m) for m in json.loads((file.parent / "symmetry.json").read_text())[file.name]]
    referee = Referee(case_of(model, symmetries=tuple(listed)))
    scale = 25.0 / model.mesh.radius
    one = Poses(turned(truth.quaternion, 4.0)[None], truth.position[None] + 0.7, np.log([scale]), np.zeros((1, 0)))
    poses = twin(one, referee._alike[0])
    w, x, y, z = poses.quaternion[0]
    true = (*truth.quaternion[1:], truth.quaternion[0])
    parts, centre = evaluator.load(file)
    vertices, faces = evaluator.posed(parts, centre, [], {})
    masks = [
        evaluator.mask(vertices, faces, q, *position, scale, 64, 64)
        for q, position in ((true, truth.position), ((x, y, z, w), poses.position[0]))
    ]
    real = referee.draw(Poses(truth.quaternion[None], truth.position[None], np.log([scale]), np.zeros((1, 0))))
    found = answer((poses.quaternion[0], poses.position[0], scale, []))
    score = referee.score(0, truth, real, found, 1.0)
    assert np.mean(real != masks[0]) < 1e-4
    assert score.iou == pytest.approx(evaluator.iou(*masks), abs=2e-3)
    symmetries = [np.eye(3), *listed]
    assert score.orientation_deg == pytest.approx(evaluator.ang([x, y, z, w], true, symmetries), abs=1e-4)


def test_a_stated_region_is_a_student_ts_of_its_covariance():
    rng, scale = np.random.default_rng(0), np.diag([1.0, 4.0, 0.25])
    draws = draw(rng, scale, POSE_DEGREES_OF_FREEDOM, 4000)
    regions = np.array([region_of(one, 2.0 * scale) for one in draws])  # of 4 degrees: twice the scale
    assert [float(np.mean(regions <= share)) for share in (0.5, 0.9)] == pytest.approx([0.5, 0.9], abs=0.025)
    assert np.isnan(region_of(np.zeros(3), np.zeros((3, 3))))

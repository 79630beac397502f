"""Tracks of a body with a mirror plane: both twins told in every frame, stored evenly, and rates that keep their sense.

The likelihood is a peak at the true pose and the same peak at its twin, as a silhouette would give it.
"""

from dataclasses import dataclass

import numpy as np
import pytest

from service.inference.articulation import Articulation, Joint, Stage
from service.inference.domain import Domain
from service.inference.modes import distance, metric_of
from service.inference.params import FilterParams, LikelihoodParams, PriorParams, SessionConfig
from service.inference.pose import angle_between, exp_so3, local, multiply, rotation_matrices
from service.inference.rotation_rate import rotation_rate
from service.inference.state import Estimate, FilterState, Frame, Measurement, Poses
from service.inference.step import one_of_twins, step
from service.inference.symmetry import Symmetry, refold, twin, unfold

WING = Joint("wing", "prismatic", -50, 50, 0.0, (Stage("prismatic", ("wing",), (0, 0, 1)),))
DOMAIN = Domain(64, 64, 3.0, Articulation(("bus", "wing"), (WING,)), PriorParams())
METRIC = metric_of(DOMAIN.articulation)
MIRROR = Symmetry(((1.0, 0, 0), (0, -1.0, 0), (0, 0, 1.0)), (0.0, 0.3, 0.0), (-1.0,), (4.0,))
LIGHT = np.full((64, 64), -1.0, np.float32)
LIGHT[22:42, 22:42] = 2.0
FULL = float(np.maximum(LIGHT, 0).sum())
WIDTH = np.array([0.15, 0.15, 0.15, 3.0, 3.0, 0.1, 8.0])
DT_S = 0.1


@dataclass(frozen=True)
class Told:
    """A frame: where the body was, and what the filter said."""

    truth: Poses
    state: FilterState
    estimate: Estimate


def pose(rotation: np.ndarray, joint: float) -> Poses:
    return Poses(rotation[None], np.array([[32.0, 31.0]]), np.log([8.0]), np.array([[joint]]))


def score_maps_of(truth: Poses):
    both = (truth, twin(truth, MIRROR))

    def score(poses: Poses, maps: np.ndarray) -> np.ndarray:
        if len(maps) > 1:  # area and centroid of silhouettes: all alike
            return np.tile([400.0] + [0.0] * (len(maps) - 1), (len(poses), 1))
        squares = [np.sum((local(one, poses) / WIDTH) ** 2, axis=1) for one in both]
        return (FULL * (2 / (1 + np.min(squares, axis=0) / 6) - 1))[:, None]

    return score


def track(rotations: np.ndarray, joints: np.ndarray, method: str = "importance", seed: int = 1) -> list[Told]:
    settings = SessionConfig(
        filter=FilterParams(method=method, particles=301, acquisition_particles=1500, seed=seed),
        likelihood=LikelihoodParams(exponent=0.05),
    )
    state, told = None, []
    for index, (rotation, joint) in enumerate(zip(rotations, joints, strict=True)):
        truth = pose(rotation, joint)
        rng = np.random.Generator(np.random.Philox(key=np.array([seed, index], np.uint64)))
        now = Frame(index, DT_S * index, Measurement(LIGHT, 0.0))
        state, estimate = step(rng, state, now, score_maps_of(truth), settings, DOMAIN, (MIRROR,))
        told.append(Told(truth, state, estimate))
    return told


def turning(axis: np.ndarray, rate_deg_per_s: float, start: np.ndarray, frames: int) -> np.ndarray:
    """(frames, 4) rotations that turn about a body axis."""
    angles = np.deg2rad(rate_deg_per_s) * DT_S * np.arange(frames)
    return multiply(exp_so3(start[None]), exp_so3(angles[:, None] * axis))


def near(estimate: Estimate, truth: Poses) -> float:
    """Weight of the modes within 5 degrees of the pose, joint within 4."""
    total = 0.0
    for mode in estimate.modes:
        close = np.rad2deg(angle_between(mode.pose.quaternion, truth.quaternion[0])) < 5
        total += mode.weight * (close and abs(mode.pose.joints[0] - truth.joints[0, 0]) < 4)
    return total


def test_both_twins_are_told_with_equal_weight_in_every_frame():
    rotations = turning(np.array([0.0, 0.6, 0.8]), 5.0, np.array([0.9, -0.6, 0.5]), 25)
    for told in track(rotations, 3.0 * np.sin(0.1 * np.arange(25))):
        other = twin(told.truth, MIRROR)
        assert near(told.estimate, told.truth) == pytest.approx(0.5, abs=0.02)
        assert near(told.estimate, other) == pytest.approx(0.5, abs=0.02)
        weights = [mode.weight for mode in told.estimate.modes[:2]]
        assert weights[0] == pytest.approx(weights[1], abs=1e-12)
        # The state holds both sides, particle by particle in turn.
        side = distance(told.state.poses, told.truth, METRIC) < distance(told.state.poses, other, METRIC)
        assert np.mean(side) == pytest.approx(0.5, abs=0.02)


def test_the_particles_of_a_state_fold_back_exactly():
    """All on one side, next to each other; unfolded again they are the state."""
    rotations = turning(np.array([0.0, 0.6, 0.8]), 5.0, np.array([0.9, -0.6, 0.5]), 8)
    for told in track(rotations, np.zeros(8))[4:]:
        folded = one_of_twins(told.state, (MIRROR,), DOMAIN)
        assert folded is not None
        weights = np.exp(folded.log_weights)
        top = folded.poses[int(np.argmax(weights)) :][:1]
        assert weights[distance(folded.poses, top, METRIC) <= 1.0].sum() > 0.99
        poses, rates = unfold(folded.poses, folded.rates, (MIRROR,), DOMAIN)
        assert angle_between(poses.quaternion, told.state.poses.quaternion).max() < 1e-12
        np.testing.assert_allclose(poses.position, told.state.poses.position, atol=1e-11)
        np.testing.assert_allclose(poses.joints, told.state.poses.joints, atol=1e-12)
        np.testing.assert_allclose(rates, told.state.rates, atol=1e-15)
        # Those whose turn is the body itself are not touched at all.
        np.testing.assert_array_equal(folded.poses.quaternion[::2], told.state.poses.quaternion[::2])


def test_folding_back_is_no_matter_of_what_is_near():
    """Three twins of a brick, random poses and rates: refold undoes unfold, however the poses lie."""
    signs = ((1.0, -1.0, 1.0), (1.0, 1.0, -1.0), (1.0, -1.0, -1.0))
    twins = [Symmetry(((a, 0, 0), (0, b, 0), (0, 0, c)), (0.0, 0.2, -0.1), (-1.0,), (3.0,)) for a, b, c in signs]
    rng = np.random.default_rng(1)
    poses = Poses(
        exp_so3(rng.standard_normal((50, 3))), rng.normal(30, 5, (50, 2)), np.full(50, 2.0), rng.normal(0, 5, (50, 1))
    )
    rates = rng.standard_normal((50, 7))
    back, back_rates = refold(*unfold(poses, rates, twins, DOMAIN), twins, DOMAIN)
    assert angle_between(back.quaternion, poses.quaternion).max() < 1e-12
    np.testing.assert_allclose(back.position, poses.position, atol=1e-11)
    np.testing.assert_allclose(back.joints, poses.joints, atol=1e-12)
    np.testing.assert_allclose(back_rates, rates, atol=1e-14)


def through_the_mirror(frames: int, rate_deg_per_s: float) -> np.ndarray:
    """Rotations that reach, half way, the pose whose twin is itself: the mirror plane seen edge on.

    Z R M = R where R carries the plane's normal y onto +-z.
    """
    edge_on = exp_so3(np.array([[np.pi / 2, 0.0, 0.0]]))
    angles = np.deg2rad(rate_deg_per_s) * DT_S * (np.arange(frames) - frames // 2)
    return multiply(edge_on, exp_so3(angles[:, None] * np.array([0.8, 0.0, 0.6])))


def test_the_degenerate_pose_is_its_own_twin():
    middle = through_the_mirror(41, 20.0)[20]
    np.testing.assert_allclose(np.abs(rotation_matrices(middle)[:, 1]), [0, 0, 1], atol=1e-12)
    assert angle_between(twin(pose(middle, 2.0), MIRROR).quaternion, middle[None])[0] < 1e-7


def test_a_body_turns_through_its_own_twin_and_keeps_its_rate():
    """20 degrees a second through the pose where both twins meet: the track comes out where it was heading."""
    frames, rate = 41, 20.0
    told = track(through_the_mirror(frames, rate), np.full(frames, 2.0))
    axis = np.array([0.8, 0.0, 0.6])
    for k in range(frames // 2 - 8, frames):
        folded = one_of_twins(told[k].state, (MIRROR,), DOMAIN)
        assert folded is not None
        weights = np.exp(folded.log_weights)
        turn = np.rad2deg(weights @ folded.rates[:, :3])
        # On which side of the twins the particles are told is the filter's to choose.
        against = turn @ -np.diag([1.0, -1.0, 1.0])  # as the other twin turns: w' = det(S) S w
        off = min(np.linalg.norm(turn - rate * axis), np.linalg.norm(against - rate * axis))
        assert off < 6, f"frame {k}"
        assert told[k].estimate.status in ("acquiring", "tracking")
    last = told[-1]
    assert near(last.estimate, last.truth) == pytest.approx(0.5, abs=0.02)


def test_the_rate_told_at_the_degenerate_pose_is_that_of_one_twin():
    frames, rate = 41, 20.0
    told = track(through_the_mirror(frames, rate), np.full(frames, 2.0))[frames // 2 + 1]
    found = rotation_rate(told.state, told.estimate.best.quaternion, n_twins=1)
    assert found is not None
    assert np.rad2deg(np.linalg.norm(found)) == pytest.approx(rate, abs=6)


def test_a_search_beside_a_young_track_does_not_take_its_twin_for_news():
    """Twelve tracks, the frames in which the space is still searched: one side of the twins holds every particle."""
    rotations = np.repeat(exp_so3(np.array([[0.9, -0.6, 0.5]])), 5, axis=0)
    for seed in range(12):
        for told in track(rotations, np.zeros(5), seed=seed)[1:]:
            folded = one_of_twins(told.state, (MIRROR,), DOMAIN)
            assert folded is not None
            sides = [np.sum(distance(folded.poses, p, METRIC) < 1) for p in (told.truth, twin(told.truth, MIRROR))]
            assert min(sides) == 0

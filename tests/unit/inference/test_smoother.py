"""The backward smoother against closed forms, and what it does with modes, twins and gaps."""

from dataclasses import replace

import numpy as np
import pytest

from service.inference.articulation import Articulation, Joint, Stage
from service.inference.belief import Belief, belief_of
from service.inference.domain import Domain
from service.inference.motion import MotionNoise
from service.inference.params import PriorParams
from service.inference.pose import angle_between, exp_so3, local, log_so3, retract
from service.inference.smoothed import summarise_belief
from service.inference.smoother import Gaussian, Space, alike, modes_of, predict, right_jacobian, smooth
from service.inference.state import FilterState, Poses
from service.inference.symmetry import Symmetry, twin

PANEL = Joint("panel", "revolute", 0, 360, 0.0, (Stage("revolute", ("panel",), (0, 0, 1)),))
DOMAIN = Domain(64, 64, 4.0, Articulation(("bus", "panel"), (PANEL,)), PriorParams())
D = 7
JITTER = np.array([0.02, 0.02, 0.02, 0.5, 0.5, 0.01, 3.0]) ** 2
MOTION = MotionNoise(100 * JITTER, JITTER, 4 * JITTER)
SPACE = Space(MOTION, DOMAIN)
START = Poses(np.array([[1.0, 0, 0, 0]]), np.array([[30.0, 34.0]]), np.array([1.0]), np.array([[350.0]]))


def pose_at(coordinates: np.ndarray) -> Poses:
    return Poses(
        exp_so3(coordinates[None, :3]),
        START.position + coordinates[3:5],
        START.log_scale + coordinates[5],
        np.mod(START.joints + coordinates[6], 360.0),
    )


def belief(time_s: float, mean: np.ndarray, covariance: np.ndarray) -> Belief:
    """One mode at coordinates and rates ``mean`` (2D,)."""
    return Belief(time_s, 1.0, np.zeros(1), pose_at(mean[:D]), mean[None, D:], covariance[None])


def steps(time_s: np.ndarray) -> list[tuple[np.ndarray, np.ndarray]]:
    """Transition and noise of the linear model between the times."""
    found = []
    for dt in np.diff(time_s):
        transition = np.eye(2 * D)
        transition[:D, D:] = dt * np.eye(D)
        noise = np.diag([*(JITTER * dt + MOTION.change * dt**3 / 3), *(MOTION.change * dt)])
        noise[:D, D:] = noise[D:, :D] = np.diag(MOTION.change * dt**2 / 2)
        found.append((transition, noise))
    return found


def kalman(model, observation: np.ndarray, noise: np.ndarray, mean: np.ndarray, covariance: np.ndarray):
    see = np.eye(D, 2 * D)
    filtered = []
    for k, seen in enumerate(observation):
        if k:
            transition, q = model[k - 1]
            mean, covariance = transition @ mean, transition @ covariance @ transition.T + q
        gain = covariance @ see.T @ np.linalg.inv(see @ covariance @ see.T + noise)
        mean, covariance = mean + gain @ (seen - see @ mean), covariance - gain @ see @ covariance
        filtered.append((mean, covariance))
    return filtered


def dense(model, observation: np.ndarray, noise: np.ndarray, mean: np.ndarray, covariance: np.ndarray):
    """All frames' states at once: the information form, solved without any recursion."""
    n, size = len(observation), 2 * D
    information, vector = np.zeros((n * size, n * size)), np.zeros(n * size)
    first = np.linalg.inv(covariance)
    information[:size, :size] += first
    vector[:size] += first @ mean
    for k, (transition, q) in enumerate(model):
        at = slice(k * size, (k + 2) * size)
        both = np.hstack([-transition, np.eye(size)])
        information[at, at] += both.T @ np.linalg.inv(q) @ both
    for k, seen in enumerate(observation):
        at = slice(k * size, k * size + D)
        information[at, at] += np.linalg.inv(noise)
        vector[at] += np.linalg.inv(noise) @ seen
    everything = np.linalg.inv(information)
    means = (everything @ vector).reshape(n, size)
    return [(means[k], everything[k * size : (k + 1) * size, k * size : (k + 1) * size]) for k in range(n)]


def test_linear_gaussian_case_is_exact():
    """Turns about one axis commute, the other coordinates are linear: the whole pass has a closed form.

    Uneven intervals, a body that turns at 40 degrees a second, a joint that passes the end of its range.
    """
    rng = np.random.default_rng(3)
    time_s = np.array([0.0, 0.1, 0.2, 0.7, 0.8, 0.9, 1.4])
    rate = np.array([0, 0, np.deg2rad(40), 3.0, -2.0, 0.05, 15.0])
    noise = np.diag([1e-9, 1e-9, 0.03**2, 0.4, 0.4, 0.02**2, 4.0])
    truth = time_s[:, None] * rate
    observation = truth + rng.standard_normal((len(time_s), D)) @ np.sqrt(noise)
    observation[:, :2] = 0.0
    mean = np.concatenate([np.zeros(D), rate])
    wide = np.diag([1e-6, 1e-6, 0.04, 9.0, 9.0, 0.01, 100.0, 1e-8, 1e-8, 0.02, 1.0, 1.0, 1e-3, 25.0])
    model = steps(time_s)
    filtered = kalman(model, observation, noise, mean, wide)
    smoothed = smooth([belief(t, m, p) for t, (m, p) in zip(time_s, filtered, strict=True)], SPACE)
    used = [k for k in range(2 * D) if k not in (0, 1, D, D + 1)]  # no turn about the other two axes
    for found, (m, p) in zip(smoothed, dense(model, observation, noise, mean, wide), strict=True):
        gap = local(pose_at(m[:D]), found.poses)[0]
        gap[6] = np.mod(gap[6] + 180, 360) - 180
        scale = np.sqrt(np.diag(p))
        assert np.all(np.abs(gap) < 1e-4 * scale[:D])
        assert np.all(np.abs(found.rates[0] - m[D:]) < 1e-4 * scale[D:])
        ratio = (found.covariance[0] - p) / np.outer(scale, scale)
        np.testing.assert_allclose(ratio[np.ix_(used, used)], 0.0, atol=1e-4)


def test_the_transition_is_the_derivative_of_the_motion():
    rate = np.array([0.9, -1.4, 0.6, 5.0, 1.0, 0.1, 20.0])
    mode = belief(0.0, np.concatenate([[0.3, -0.2, 0.5, 1, 2, 0.1, 4], rate]), 1e-12 * np.eye(2 * D))
    forecast = predict_one(mode, rate, 0.8)
    for k in range(2 * D):
        step = 1e-6 * np.eye(2 * D)[k]
        moved = replace(mode, poses=retracted(mode.poses, step[:D]), rates=mode.rates + step[D:])
        other = predict_one(moved, rate + step[D:], 0.8)
        slope = local(forecast.after.pose, other.after.pose)[0] / 1e-6
        np.testing.assert_allclose(forecast.transition[:D, k], slope, atol=1e-4)


def retracted(poses: Poses, step: np.ndarray) -> Poses:
    return retract(poses, step[None])


def predict_one(mode: Belief, rate: np.ndarray, dt_s: float):
    return predict(Gaussian(mode.poses, rate, mode.covariance[0]), dt_s, 1.0, MOTION)


def test_right_jacobian_of_small_and_large_turns():
    for vector in (np.array([1e-6, 2e-6, 0.0]), np.array([0.4, -1.1, 0.7])):
        for k in range(3):
            step = 1e-6 * np.eye(3)[k]
            turned = local(
                replace(START, quaternion=exp_so3(vector[None])),
                replace(START, quaternion=exp_so3((vector + step)[None])),
            )[0, :3]
            np.testing.assert_allclose(right_jacobian(vector)[:, k], turned / 1e-6, atol=1e-5)


SMALL = np.diag([*(np.full(3, 0.02**2)), 0.2, 0.2, 1e-4, 4.0, *(0.5 * MOTION.variance)])


def two_modes(time_s: float, share: float, apart: float) -> Belief:
    near, far = np.zeros(2 * D), np.zeros(2 * D)
    far[1] = apart
    a, b = belief(time_s, near, SMALL), belief(time_s, far, SMALL)
    poses = Poses(*(np.concatenate(pair) for pair in zip(vars(a.poses).values(), vars(b.poses).values(), strict=True)))
    weights = np.log([share, 1 - share])
    return Belief(time_s, 1.0, weights, poses, np.zeros((2, D)), np.concatenate([a.covariance, b.covariance]))


def test_later_frames_decide_between_modes():
    first, last = two_modes(0.0, 0.3, 1.0), belief(0.2, np.zeros(2 * D), SMALL)
    smoothed = smooth([first, two_modes(0.1, 0.4, 1.0), last], SPACE)
    for found in smoothed:
        assert len(found) == 1
        assert angle_between(found.poses.quaternion, START.quaternion)[0] < 1e-6


def test_what_a_search_found_elsewhere_tells_nothing_of_before():
    elsewhere = np.zeros(2 * D)
    elsewhere[:3] = [0, 2.0, 0]
    before = belief(0.0, np.zeros(2 * D), SMALL)
    found = smooth([before, belief(0.1, elsewhere, SMALL)], SPACE)[0]
    np.testing.assert_allclose(found.poses.quaternion, before.poses.quaternion, atol=1e-9)
    np.testing.assert_allclose(found.covariance, before.covariance, rtol=1e-6)


def test_a_frame_without_belief_is_bridged():
    one, three = belief(0.0, np.zeros(2 * D), SMALL), belief(0.2, np.zeros(2 * D), SMALL)
    assert smooth([None, one, None, three, None], SPACE)[::2] == [None, None, None]
    found = smooth([one, None, three], SPACE)[0]
    assert np.trace(found.covariance[0]) < np.trace(one.covariance[0])
    assert smooth([None, None], SPACE) == [None, None]


MIRROR = Symmetry(((-1, 0, 0), (0, 1, 0), (0, 0, 1)), (0.3, 0.0, 0.0), (-1.0,), (40.0,))


def test_a_later_twin_is_as_good_as_the_pose_itself():
    """A renewed search may have come upon the mirror image: the pass goes on, seen through the mirror."""
    drift = np.concatenate([[0.05, 0.02, -0.03, 0.5, -0.4, 0.01, 2.0], np.zeros(D)])
    before, after = belief(0.0, np.zeros(2 * D), SMALL), belief(0.1, drift, SMALL)
    space = Space(MOTION, DOMAIN, (MIRROR,))
    plain = smooth([before, after], space)[0]
    imaged = mirrored(after)
    through = smooth([before, imaged], space)[0]
    np.testing.assert_allclose(local(plain.poses, through.poses), 0, atol=1e-7)
    np.testing.assert_allclose(plain.covariance, through.covariance, atol=1e-6)


def mirrored(given: Belief) -> Belief:
    """The same posterior, as a search that came upon the mirror image would have it."""
    (mode,) = modes_of(given)
    image = list(alike(mode, Space(MOTION, DOMAIN, (MIRROR,))))[1]
    return replace(given, poses=image.pose, rates=image.rate[None], covariance=image.covariance[None])


def cloud(n: int = 4000) -> tuple[Poses, np.ndarray]:
    rng = np.random.default_rng(5)
    x = rng.multivariate_normal(np.zeros(2 * D), SMALL, n)
    poses = Poses(
        exp_so3(x[:, :3]), START.position + x[:, 3:5], START.log_scale + x[:, 5], np.mod(350 + x[:, 6:7], 360.0)
    )
    return poses, x[:, D:]


def test_particles_become_the_belief_they_came_from():
    """The joint's values lie on both sides of the end of its range."""
    poses, rates = cloud()
    weights = np.full(len(poses), -np.log(len(poses)))
    found = belief_of(FilterState(poses, weights, rates, 0, 0.0, "tracking"), DOMAIN)
    assert len(found) == 1
    scale = np.sqrt(np.diag(SMALL))
    np.testing.assert_allclose(found.covariance[0] / np.outer(scale, scale), np.eye(2 * D), atol=0.1)
    assert np.linalg.norm(log_so3(found.poses.quaternion)) < 0.005
    told = summarise_belief(found, (MIRROR,), DOMAIN, True)
    assert [round(mode.weight, 9) for mode in told.modes] == [0.5, 0.5]
    image = twin(START, MIRROR)
    for pose in (START, image):
        assert min(np.rad2deg(angle_between(m.pose.quaternion, pose.quaternion[0])) for m in told.modes) < 0.5
    assert told.modes[0].spread.orientation_deg == pytest.approx(np.rad2deg(0.02 * np.sqrt(3)), rel=0.05)
    assert told.rates.deviation == pytest.approx(scale[D:], rel=0.1)


def test_of_a_body_of_revolution_the_turn_about_its_axis_is_told_as_unknown():
    poses, rates = cloud()
    found = belief_of(FilterState(poses, np.full(len(poses), -np.log(len(poses))), rates, 0, 0.0, "tracking"), DOMAIN)
    round_body = replace(DOMAIN, articulation=replace(DOMAIN.articulation, round_axes=((0.0, 0.0, 1.0),)))
    told = summarise_belief(found, (), round_body, True)
    assert told.spread.orientation_deg == pytest.approx(180 / np.sqrt(3), rel=0.02)
    assert np.sqrt(told.spread.covariance[0, 0]) == pytest.approx(np.rad2deg(0.02), rel=0.2)


def test_nothing_is_believed_before_anything_was_seen():
    poses, rates = cloud(50)
    weights = np.full(50, -np.log(50))
    state = FilterState(poses, weights, rates, 0, 0.0, "no_target")
    assert belief_of(state, DOMAIN) is None

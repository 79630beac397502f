"""A joint that turns all the way round is followed across the end of its range."""

import numpy as np
import pytest

from service.inference.articulation import Articulation, Joint, Stage
from service.inference.domain import Domain
from service.inference.params import FilterParams, LikelihoodParams, MotionParams, PriorParams, SessionConfig
from service.inference.pose import angle_between
from service.inference.state import Frame, Measurement, Poses
from service.inference.step import step

PANEL = Joint("panel", "revolute", 0, 360, 0.0, (Stage("revolute", ("panel",), (0, 0, 1)),))
DOMAIN = Domain(64, 64, 4.0, Articulation(("bus", "panel"), (PANEL,)), PriorParams())
EXPONENT = 0.05
LIGHT = np.full((64, 64), -1.0, np.float32)
LIGHT[25:39, 25:39] = 2.0
FULL = float(np.maximum(LIGHT, 0).sum())
TRUE_ROTATION = np.array([0.5, 0.5, -0.5, 0.5])
JOINT_DEG = 10.0
TURN_DEG_PER_S = 6.0


def score_maps_of(panel_deg: float):
    """A likelihood with one peak, circular in the joint, in the shape that a scorer gives it."""

    def score(poses: Poses, maps: np.ndarray) -> np.ndarray:
        if len(maps) > 1:  # area and centroid of silhouettes: all alike
            return np.tile([196.0] + [0.0] * (len(maps) - 1), (len(poses), 1))
        joint = np.mod(poses.joints[:, 0] - panel_deg + 180, 360) - 180
        distance = (angle_between(poses.quaternion, TRUE_ROTATION) / 0.15) ** 2 + (joint / JOINT_DEG) ** 2
        distance += np.sum((poses.position - 32) ** 2, axis=1) / 4 + ((poses.log_scale - np.log(8)) / 0.1) ** 2
        return (FULL * (2 / (1 + distance / 3) - 1))[:, None]

    return score


def track(method: str, start: float, frames: int, dt_s: float):
    settings = SessionConfig(
        filter=FilterParams(method=method, particles=200, acquisition_particles=600),
        likelihood=LikelihoodParams(exponent=EXPONENT),
    )
    state, told = None, []
    for index in range(frames):
        angle = (start + TURN_DEG_PER_S * dt_s * index) % 360
        rng = np.random.Generator(np.random.Philox(key=np.array([1, index], np.uint64)))
        state, estimate = step(
            rng, state, Frame(index, dt_s * index, Measurement(LIGHT, 0.0)), score_maps_of(angle), settings, DOMAIN
        )
        told.append((angle, state, estimate))
    return told


def kalman_rate_deviation(frames: int, dt_s: float) -> np.ndarray:
    """(frames,) deviation of the joint's rate after each frame, degrees per second, with the default motion.

    The peak's curvature gives the measurement's variance: log L = -(2/3) FULL EXPONENT (v / JOINT_DEG)^2.
    """
    motion = MotionParams()
    seen = JOINT_DEG**2 * 3 / (4 * FULL * EXPONENT)
    change = (motion.rate_change * motion.joint_deg) ** 2
    carry = np.array([[1, dt_s], [0, 1]])
    noise = np.diag([motion.joint_deg**2 * dt_s + change * dt_s**3 / 3, change * dt_s])
    covariance = np.diag([seen, (motion.rate_spread * motion.joint_deg) ** 2])
    deviations = [np.sqrt(covariance[1, 1])]
    for _ in range(frames - 1):
        covariance = carry @ covariance @ carry.T + noise
        gain = covariance[:, 0] / (covariance[0, 0] + seen)
        covariance = covariance - np.outer(gain, covariance[0])
        deviations.append(np.sqrt(covariance[1, 1]))
    return np.array(deviations)


def check_the_joint(angle: float, state, estimate) -> None:
    assert 0 <= state.poses.joints.min() <= state.poses.joints.max() <= 360
    assert 0 <= estimate.mean.joints[0] <= 360
    off = np.mod(estimate.mean.joints[0] - angle + 180, 360) - 180
    assert abs(off) < 6
    assert estimate.spread.joints[0] < 10
    assert len(estimate.modes) == 1


@pytest.mark.parametrize("start", [90.0, 345.0])
def test_the_joint_and_its_rate_are_followed_by_importance(start):
    """The same; rates are samples of the posterior: their mean is right within a spread that is a Kalman filter's."""
    frames, dt_s = 24, 0.1
    expected = kalman_rate_deviation(frames, dt_s)
    for told, deviation in list(zip(track("importance", start, frames, dt_s), expected, strict=True))[4:]:
        check_the_joint(*told)
        weights, rates = np.exp(told[1].log_weights), told[1].rates[:, 6]
        mean = weights @ rates
        spread = np.sqrt(weights @ (rates - mean) ** 2)
        assert abs(mean - TURN_DEG_PER_S) < 3 * spread
        assert 0.6 * deviation < spread < 2.0 * deviation


@pytest.mark.parametrize("start", [90.0, 345.0])
def test_a_prediction_far_wider_than_the_peak_is_no_obstacle(start):
    """Half a second between frames: 10 px predicted about a peak of 0.4 px in a likelihood that is flat elsewhere."""
    for told in track("importance", start, 12, 0.5)[1:]:
        assert told[2].status in ("acquiring", "tracking")
        assert told[2].ess > 10
        check_the_joint(*told)

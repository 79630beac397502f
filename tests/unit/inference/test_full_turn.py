"""A joint that turns all the way round is followed across the end of its range."""

import numpy as np
import pytest

from service.inference.articulation import Articulation, Joint, Stage
from service.inference.domain import Domain
from service.inference.params import FilterParams, PriorParams, SessionConfig
from service.inference.pose import angle_between
from service.inference.state import Frame, Measurement, Poses
from service.inference.step import step

PANEL = Joint("panel", "revolute", 0, 360, 0.0, (Stage("revolute", ("panel",), (0, 0, 1)),))
DOMAIN = Domain(64, 64, 4.0, Articulation(("bus", "panel"), (PANEL,)), PriorParams())
SETTINGS = SessionConfig(filter=FilterParams(particles=200, acquisition_particles=600))
LIGHT = np.full((64, 64), -1.0, np.float32)
LIGHT[25:39, 25:39] = 2.0
FULL = float(np.maximum(LIGHT, 0).sum())
TRUE_ROTATION = np.array([0.5, 0.5, -0.5, 0.5])


def score_maps_of(panel_deg: float):
    """A likelihood with one peak, circular in the joint, in the shape that a scorer gives it."""

    def score(poses: Poses, maps: np.ndarray) -> np.ndarray:
        if len(maps) > 1:  # area and centroid of silhouettes: all alike
            return np.tile([196.0] + [0.0] * (len(maps) - 1), (len(poses), 1))
        joint = np.mod(poses.joints[:, 0] - panel_deg + 180, 360) - 180
        distance = (angle_between(poses.quaternion, TRUE_ROTATION) / 0.15) ** 2 + (joint / 10) ** 2
        distance += np.sum((poses.position - 32) ** 2, axis=1) / 4 + ((poses.log_scale - np.log(8)) / 0.1) ** 2
        return (FULL * (2 / (1 + distance / 3) - 1))[:, None]

    return score


def track(angles: list[float]):
    state, told = None, []
    for index, angle in enumerate(angles):
        rng = np.random.Generator(np.random.Philox(key=np.array([1, index], np.uint64)))
        state, estimate = step(
            rng, state, Frame(index, 0.5 * index, Measurement(LIGHT, 0.0)), score_maps_of(angle), SETTINGS, DOMAIN
        )
        told.append((angle, state, estimate))
    return told


@pytest.mark.parametrize("start", [90.0, 345.0])
def test_the_joint_and_its_rate_are_followed(start):
    """6 degrees a second, far from the end of the range and across it."""
    for angle, state, estimate in track([(start + 3 * k) % 360 for k in range(12)])[4:]:
        assert 0 <= state.poses.joints.min() <= state.poses.joints.max() <= 360
        assert 0 <= estimate.mean.joints[0] <= 360
        off = np.mod(estimate.mean.joints[0] - angle + 180, 360) - 180
        assert abs(off) < 6
        assert estimate.spread.joints[0] < 10
        assert np.sqrt(np.mean(state.rates[:, 6] ** 2)) < 30  # degrees a second
        assert len(estimate.modes) == 1

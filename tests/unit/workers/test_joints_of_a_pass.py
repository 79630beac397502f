"""Joints of a pass as the worker is asked for it: the demo satellite's wing, followed over a minute."""

from dataclasses import replace

import numpy as np
import pytest

from gpu.mesh import load_mesh
from service.inference.belief import Belief
from service.inference.params import JointParams, SessionConfig
from service.inference.pose import exp_so3, multiply, retract, rotation_matrices
from service.inference.spin.basins import PassMotion
from service.inference.state import Poses
from service.simulate.satellite import demo_satellite
from service.workers.base import ModelJob, MotionJob
from service.workers.codec import encode
from service.workers.motion import motion_of
from service.workers.panels import sun_tracking
from service.workers.tracker import Tracker

FRAMES, RATE = 20, np.deg2rad([0.8, 0.5, -0.3])
SUN = np.array([0.6, -0.64, 0.48])
WING = SessionConfig(joints=JointParams(free="all"))


@pytest.fixture(scope="module")
def body():
    tracker = Tracker()
    try:
        articulation = tracker.prepare_model(ModelJob(demo_satellite(), "glb")).articulation
    finally:
        tracker.close()
    return load_mesh(demo_satellite(), "glb"), articulation


def told(body, law: str, config: SessionConfig = WING, offset_deg: float = 4.0) -> PassMotion:
    mesh, articulation = body
    tracking = sun_tracking(mesh, articulation, JointParams(free="all", sun_tracking=("wing",)))
    rng, beliefs, camera = np.random.default_rng(3), [], exp_so3(np.array([0.2, 0.5, -0.9]))
    sun = rotation_matrices(camera).T @ SUN
    deviation = np.array([*[np.deg2rad(0.5)] * 3, 0.1, 0.1, 1e-2, 1.5])
    for k in range(FRAMES):
        q = multiply(exp_so3(np.array([0.3, -0.2, 0.8])), exp_so3(2.0 * k * RATE))
        pose = Poses(q[None], np.full((1, 2), 64.0), np.zeros(1), np.full((1, 1), 20.0))
        if law == "sun_tracking":
            pose = tracking.pointed(pose, sun[None])
            pose = replace(pose, joints=pose.joints + offset_deg)
        pose = retract(pose, deviation * rng.standard_normal((1, 7)))
        covariance = np.diag(np.concatenate([2 * deviation**2, np.ones(7)]))[None]
        beliefs.append(encode(Belief(2.0 * k, 1.0, np.zeros(1), pose, np.zeros((1, 7)), covariance, each=True)))
    across = np.cross([0.0, 1.0, 0.0], SUN) / np.linalg.norm(np.cross([0.0, 1.0, 0.0], SUN))
    frame = np.column_stack([across, np.cross(SUN, across), SUN])
    references = {name: np.tile(frame, (FRAMES, 1, 1)) for name in ("nadir_pointing", "yaw_steering", "sun_pointing")}
    seen = tuple(beliefs), (True,) * FRAMES, (camera,) * FRAMES, references
    return motion_of(MotionJob(config, "", "glb", articulation, (), 128, 128, *seen), mesh)


@pytest.mark.parametrize(("law", "constant"), [("still", 20.0), ("sun_tracking", 4.0)])
def test_a_wing_that_stands_still_and_one_that_follows_the_sun(body, law, constant):
    (wing,) = told(body, law).joints
    assert (wing.name, wing.best) == ("wing", law)
    value, sigma = wing.constants[law]
    assert value == pytest.approx(constant, abs=4 * sigma) and sigma < 2.0


def test_a_wing_that_was_told_to_follow_the_sun_is_not_judged(body):
    joints = JointParams(free="all", sun_tracking=("wing",))
    assert told(body, "sun_tracking", SessionConfig(joints=joints)).joints == ()

"""What a frame says by itself, divided out of posteriors that hold all frames before it."""

import numpy as np
import pytest

from service.inference.articulation import Articulation
from service.inference.belief import Belief
from service.inference.domain import Domain
from service.inference.model.dynamics import corrected, new_born, predicted
from service.inference.motion import motion_noise
from service.inference.params import MotionParams, PriorParams
from service.inference.pose import angle_between, exp_so3, local, retract
from service.inference.spin.own import own_likelihoods
from service.inference.state import Poses

DOMAIN = Domain(128, 128, 1.0, Articulation(("body",), ()), PriorParams())
NOISE = motion_noise(MotionParams(), DOMAIN)


def measured(rng, rate: np.ndarray, n: int) -> tuple[list[Poses], list[np.ndarray]]:
    """Poses that turn, each seen with an error and a spread of its own."""
    poses, spreads = [], []
    for k in range(n):
        q = exp_so3(rate * 0.1 * k)[None]
        root = np.diag([0.02, 0.03, 0.01, 0.2, 0.2, 0.01]) @ (np.eye(6) + 0.2 * rng.normal(size=(6, 6)))
        spreads.append(root @ root.T)
        true = Poses(q, np.full((1, 2), 60.0), np.zeros(1), np.zeros((1, 0)))
        poses.append(retract(true, (root @ rng.normal(size=6))[None]))
    return poses, spreads


def filtered(poses: list[Poses], spreads: list[np.ndarray]) -> list[Belief]:
    """The Kalman filter of ``filters.mixture``, of one mode; weights that forget, of two."""
    covariance = new_born(spreads[0], NOISE)
    pose, rates = poses[0], np.zeros(6)
    beliefs = [belief(0.0, pose, rates, covariance)]
    for k in range(1, len(poses)):
        ahead, carried = predicted(covariance, NOISE, 0.1), retract(pose, rates[None] * 0.1)
        after = np.linalg.inv(np.linalg.inv(ahead[:6, :6]) + np.linalg.inv(spreads[k]))
        shift = after @ np.linalg.solve(spreads[k], local(carried, poses[k])[0])
        rates, covariance = corrected(rates, ahead, shift, after)
        pose = retract(carried, shift[None])
        beliefs.append(belief(0.1 * k, pose, rates, covariance))
    return beliefs


def belief(time_s: float, pose: Poses, rates: np.ndarray, covariance: np.ndarray) -> Belief:
    return Belief(time_s, 1.0, np.zeros(1), pose, rates[None], 2 * covariance[None], each=True)


def test_a_frames_own_measurement_comes_back_out_of_the_filters_posteriors():
    poses, spreads = measured(np.random.default_rng(0), np.array([0.3, -0.2, 0.5]), 12)
    beliefs = filtered(poses, spreads)
    own = own_likelihoods(beliefs, NOISE, DOMAIN, bootstrap=False)
    for pose, spread, one, after in zip(poses, spreads, own, beliefs, strict=True):
        assert angle_between(one.quaternion, pose.quaternion)[0] < 2e-3  # the tangent's curvature
        np.testing.assert_allclose(one.covariance[0], spread[:3, :3], rtol=1e-6)
        assert np.trace(after.covariance[0][:3, :3]) / 2 <= np.trace(spread[:3, :3]) * (1 + 1e-9)


def test_a_birth_is_all_the_frames_own_and_a_wait_says_nothing():
    poses, spreads = measured(np.random.default_rng(1), np.zeros(3), 2)
    first = belief(0.0, poses[0], np.zeros(6), new_born(spreads[0], NOISE))
    born = belief(0.1, poses[1], np.zeros(6), new_born(spreads[1], NOISE))
    own = own_likelihoods([first, None, born], NOISE, DOMAIN, bootstrap=False)
    assert own[1] is None
    np.testing.assert_allclose(own[2].covariance[0], spreads[1][:3, :3], rtol=1e-9)
    ahead = predicted(new_born(spreads[0], NOISE), NOISE, 0.1)
    waited = belief(0.1, poses[0], np.zeros(6), ahead)
    alone = own_likelihoods([first, waited], NOISE, DOMAIN, bootstrap=False)[1]
    assert np.linalg.eigvalsh(alone.covariance[0])[0] > 100 * ahead[0, 0]


def test_particles_that_jitter_are_divided_by_their_prediction():
    noise = motion_noise(MotionParams(kind="jitter", rotation_deg=6.0), DOMAIN)
    poses, spreads = measured(np.random.default_rng(2), np.zeros(3), 2)
    before = Belief(0.0, 1.0, np.zeros(1), poses[0], np.zeros((1, 6)), wide(spreads[0])[None], each=True)
    expected = spreads[0] + np.diag(noise.jitter * 0.1)
    after = np.linalg.inv(np.linalg.inv(expected) + np.linalg.inv(spreads[1]))
    shift = after @ np.linalg.solve(spreads[1], local(poses[0], poses[1])[0])
    pose = retract(poses[0], shift[None])
    second = Belief(0.1, 1.0, np.zeros(1), pose, np.zeros((1, 6)), wide(after)[None], each=True)
    own = own_likelihoods([before, second], noise, DOMAIN, bootstrap=True)[1]
    np.testing.assert_allclose(own.covariance[0], spreads[1][:3, :3], rtol=1e-3)
    assert angle_between(own.quaternion, poses[1].quaternion)[0] == pytest.approx(0.0, abs=2e-3)


def wide(pose_covariance: np.ndarray) -> np.ndarray:
    out = np.zeros((12, 12))
    out[:6, :6] = pose_covariance
    return out

"""Which of a body's twins is followed, where the body is symmetric but for a detail."""

import numpy as np
import pytest

from service.inference.articulation import Articulation
from service.inference.domain import Domain
from service.inference.mixture import Draws
from service.inference.modes import distance
from service.inference.params import FilterParams, PriorParams, SessionConfig
from service.inference.peak import best_pose, heading, likeliest_twin
from service.inference.pose import concatenate, local, retract
from service.inference.state import FilterState, Frame, Measurement, Poses
from service.inference.symmetry import Symmetry, twin
from service.inference.update import Update

MIRROR = Symmetry(((-1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)))
DOMAIN = Domain(256, 256, 1.0, Articulation(("bus",), ()), PriorParams())
TRUTH = Poses(np.array([[0.8, 0.36, 0.48, 0.0]]), np.array([[120.0, 130.0]]), np.log([50.0]), np.zeros((1, 0)))
DEVIATION = np.array([0.02, 0.02, 0.02, 0.5, 0.5, 0.01])


def repeated(pose: Poses, count: int) -> Poses:
    arrays = (pose.quaternion, pose.position, pose.log_scale, pose.joints)
    return Poses(*(np.repeat(a, count, axis=0) for a in arrays))


def peak_at(pose: Poses, height: float):
    return lambda poses: height - 0.5 * np.sum((local(pose, poses) / DEVIATION) ** 2, axis=1)


def update_where_the_other_side_is(lower: float) -> tuple[Update, Draws]:
    """Particles about the twin's own best fit, two degrees beside the true pose's twin."""
    beside = retract(twin(TRUTH, MIRROR), np.array([[0.0, 0.035, 0.0, 0.0, 0.0, 0.0]]))
    right, wrong = peak_at(TRUTH, 1000.0), peak_at(beside, 1000.0 - lower)
    frame = Frame(0, 0.0, Measurement(np.full((256, 256), 0.01, np.float32), 0.0))
    rng = np.random.Generator(np.random.Philox(3))
    update = Update(
        rng,
        None,
        frame,
        lambda poses, maps: np.maximum(right(poses), wrong(poses))[:, None],
        SessionConfig(),
        DOMAIN,
        (MIRROR,),
    )
    poses = retract(repeated(beside, 200), rng.standard_normal((200, 6)) * DEVIATION)
    return update, Draws(poses, np.ones((200, 6)), update.score(poses), np.zeros(200))


def test_the_side_that_fits_better_is_taken():
    update, draws = update_where_the_other_side_is(lower=60.0)
    chosen = likeliest_twin(update, draws)
    assert distance(best_pose(update, chosen)[0], TRUTH, update.metric)[0] < 0.1
    np.testing.assert_allclose(chosen.log_likelihood, update.score(chosen.poses))
    np.testing.assert_array_equal(chosen.rates[0], [1, -1, -1, 1, 1, 1])  # an axial vector in a mirror
    gain = update.config.likelihood.exponent * (chosen.log_likelihood - draws.log_likelihood)
    np.testing.assert_allclose(chosen.log_weights, gain)


@pytest.mark.parametrize("lower", [0.0, 5.0, -60.0])
def test_a_side_that_fits_as_well_is_kept(lower):
    update, draws = update_where_the_other_side_is(lower)
    assert likeliest_twin(update, draws) is draws


def two_modes(prefer: str) -> tuple[Update, Draws, Poses, Poses]:
    """A light mode of high likelihood and a heavy one of lower; the last frame's best was heading for the heavy one."""
    light, heavy = TRUTH, retract(TRUTH, np.array([[0.0, 0.0, 1.0, 0.0, 0.0, 0.0]]))
    high, low = peak_at(light, 1000.0), peak_at(heavy, 900.0)
    rng = np.random.Generator(np.random.Philox(4))
    frame = Frame(1, 1.0, Measurement(np.full((256, 256), 0.01, np.float32), 0.0))
    rate = np.array([0.0, 0.0, 0.3, 0.0, 0.0, 0.0])
    before = retract(heavy, -rate[None])
    state = FilterState(
        before,
        np.zeros(1),
        rate[None],
        0,
        0.0,
        "tracking",
        {
            "heading_quaternion": before.quaternion,
            "heading_position": before.position,
            "heading_log_scale": before.log_scale,
            "heading_joints": before.joints,
            "heading_rate": rate,
        },
    )
    config = SessionConfig(filter=FilterParams(prefer=prefer))
    score = lambda poses, maps: np.maximum(high(poses), low(poses))[:, None]  # noqa: E731
    update = Update(rng, state, frame, score, config, DOMAIN, ())
    poses = concatenate(
        *(retract(repeated(at, 100), rng.standard_normal((100, 6)) * DEVIATION) for at in (light, heavy))
    )
    log_weights = np.log(np.repeat([0.3 / 100, 0.7 / 100], 100))
    return update, Draws(poses, np.tile(rate, (200, 1)), update.score(poses), log_weights), light, heavy


@pytest.mark.parametrize(("rule", "expected"), [("likelihood", 0), ("weight", 1), ("continuity", 1)])
def test_the_best_pose_is_of_the_preferred_mode(rule, expected):
    update, draws, *modes = two_modes(rule)
    best, _ = best_pose(update, draws)
    assert distance(best, modes[expected], update.metric)[0] < 0.1
    known = heading(update, draws, best)
    assert set(known) == (set(update.state.memory) if rule == "continuity" else set())


def test_continuity_without_a_mode_that_goes_on_takes_the_heaviest():
    update, draws, _, heavy = two_modes("continuity")
    update.state.memory["heading_rate"][:] = [0.0, 2.0, 0.0, 0.0, 0.0, 0.0]
    assert distance(best_pose(update, draws)[0], heavy, update.metric)[0] < 0.1

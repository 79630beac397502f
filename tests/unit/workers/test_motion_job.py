"""The motion of a pass as the worker is asked for it: symmetries, cameras, and what a mesh says of the masses."""

from dataclasses import replace

import numpy as np
import pytest

from gpu.mesh import Mesh, Part
from service.errors import ConflictError
from service.inference.articulation import Articulation
from service.inference.belief import Belief
from service.inference.params import FilterParams, MotionParams, SessionConfig
from service.inference.pose import conjugate, exp_so3, multiply, rotation_matrices
from service.inference.state import Poses
from service.inference.symmetry import Symmetry, twin_rates
from service.workers.base import MotionJob
from service.workers.codec import decode, encode
from service.workers.motion import motion_of, second_moments

RATE = np.deg2rad([6.0, 2.0, -3.0])
MIRROR = Symmetry(((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, -1.0)))
TURN = Symmetry(((-1.0, 0.0, 0.0), (0.0, -1.0, 0.0), (0.0, 0.0, 1.0)))
OUTLINES = SessionConfig(filter=FilterParams(preset="paper", method="bootstrap"), motion=MotionParams(kind="jitter"))


def job(
    twins: tuple[Symmetry, ...],
    config: SessionConfig = OUTLINES,
    frames: int = 25,
    seed: int = 0,
    late_s: float = 0.0,
    **given,
) -> MotionJob:
    rng, beliefs = np.random.default_rng(seed), []
    for k in range(frames):
        q = multiply(exp_so3(RATE * (0.5 * k + late_s)), exp_so3(np.deg2rad(0.3) * rng.normal(size=3)))[None]
        pose = Poses(q, np.full((1, 2), 32.0), np.zeros(1), np.zeros((1, 0)))
        covariance = np.diag([np.deg2rad(0.3) ** 2] * 3 + [0.1, 0.1, 1e-4] + [0.1] * 6)[None]
        beliefs.append(encode(Belief(0.5 * k, 1.0, np.zeros(1), pose, np.zeros((1, 6)), covariance, each=True)))
    counts = (True,) * frames
    return MotionJob(config, "", "glb", Articulation(("body",), ()), twins, 64, 64, tuple(beliefs), counts, **given)


def test_outlines_leave_the_mirrored_motion_as_likely():
    found = motion_of(job((MIRROR,)), None)
    courses = found.courses()
    assert [p for p, _ in courses] == pytest.approx([0.5, 0.5], abs=0.02)
    rates = np.array([one.motion.rate[0] for _, one in courses])
    mirrored = twin_rates(np.append(RATE, np.zeros(3))[None], MIRROR)[0, :3]
    for expected in (RATE, mirrored):
        assert np.min(np.linalg.norm(rates - expected, axis=1)) < np.deg2rad(0.1)


def test_light_tells_mirror_twins_apart_and_a_turned_body_is_told_once():
    found = motion_of(job((MIRROR, TURN), SessionConfig()), None)
    assert len(found.courses()) == 1
    assert np.linalg.norm(np.abs(found.basins[0].motion.rate[0]) - np.abs(RATE)) < np.deg2rad(0.1)


def test_cameras_turn_what_frames_say_into_fixed_axes():
    camera = exp_so3(np.array([0.3, -1.0, 0.5]))
    alone, turned = (motion_of(job(()), None), motion_of(job((), cameras=(camera,) * 25), None))
    first, second = alone.basins[0].motion, turned.basins[0].motion
    np.testing.assert_allclose(
        rotation_matrices(second.quaternion), rotation_matrices(multiply(camera, first.quaternion)), atol=1e-3
    )
    np.testing.assert_allclose(second.rate, first.rate, atol=1e-4)


def test_too_few_frames_are_refused():
    with pytest.raises(ConflictError, match="3 frames"):
        motion_of(job((), frames=2), None)


def test_a_shells_second_moments():
    corners = np.array([[x, y, z] for x in (-1, 1) for y in (-2, 2) for z in (-3, 3)], float)
    faces = [
        [0, 1, 3],
        [0, 3, 2],
        [4, 6, 7],
        [4, 7, 5],
        [0, 4, 5],
        [0, 5, 1],
        [2, 3, 7],
        [2, 7, 6],
        [0, 2, 6],
        [0, 6, 4],
        [1, 5, 7],
        [1, 7, 3],
    ]
    part = Part("body", corners + 5.0, np.array(faces, np.int32))
    found = second_moments(Mesh((part,), (0.0, 0.0, 0.0), (2.0, 4.0, 6.0), 3.7, True))
    areas = 8 * np.array([6.0, 3.0, 2.0])  # of the pairs of sides across x, y, z
    half = np.array([1.0, 2.0, 3.0])
    expected = [(areas @ (half[k] ** 2 * np.where(np.arange(3) == k, 1.0, 1 / 3))) / areas.sum() for k in range(3)]
    np.testing.assert_allclose(found, np.diag(expected), atol=1e-12)


def test_two_telescopes_tell_mirror_twins_apart_and_more_precisely():
    """A twin as one sees it is none as another does: outlines alone leave it in doubt, seen from two sides not."""
    cameras = [exp_so3(np.array(one)) for one in ([0.3, -1.0, 0.5], [0.1, -0.6, 0.4])]
    here = job((MIRROR,), cameras=(cameras[0],) * 25)
    beliefs = []
    for packed in job((), seed=1, late_s=0.2).beliefs:
        one = decode(Belief, packed)
        turned = multiply(conjugate(cameras[1]), multiply(cameras[0], one.poses.quaternion))
        beliefs.append(encode(replace(one, poses=replace(one.poses, quaternion=turned))))
    there = replace(here, beliefs=tuple(beliefs), cameras=(cameras[1],) * 25, offset_s=0.2)
    alone, both = motion_of(here, None), motion_of(replace(here, others=(there,)), None)
    assert [p for p, _ in alone.courses()] == pytest.approx([0.5, 0.5], abs=0.02)
    assert both.courses()[0][0] > 0.99
    assert both.n_frames == 50
    assert np.linalg.norm(both.basins[0].motion.rate[0] - RATE) < np.deg2rad(0.1)
    turn = [np.sqrt(np.trace(found.basins[0].covariance[:3, :3])) for found in (alone, both)]
    assert turn[1] < 0.85 * turn[0]

"""Frames that spacecraft are held in, and which of them a pass is of."""

import numpy as np
import pytest

from service.bench.mode_streams import draw_orientations, draw_references
from service.bench.motion_streams import seen_stream
from service.inference.pose import exp_so3, multiply, rotation_matrices
from service.inference.spin.alignment import ALIGNMENTS, log_aligned_or_any, log_axis_along_z, offset, tilt
from service.inference.spin.attitude_modes import attitude_modes
from service.inference.spin.fit import fit_pass
from service.inference.spin.held_frames import nadir_frames, sun_frames, yaw_steering_frames

RNG = np.random.default_rng(0)


def test_frames_point_where_they_should():
    place, velocity, sun = RNG.normal(size=(3, 20, 3))
    for frames in (nadir_frames(place, velocity), yaw_steering_frames(place, sun), sun_frames(sun)):
        np.testing.assert_allclose(
            frames @ np.swapaxes(frames, 1, 2), np.broadcast_to(np.eye(3), (20, 3, 3)), atol=1e-12
        )
        np.testing.assert_allclose(np.linalg.det(frames), 1.0)
    nadir, yaw = nadir_frames(place, velocity), yaw_steering_frames(place, sun)
    assert np.all(np.einsum("ni,ni->n", nadir[:, :, 2], place) < 0)
    np.testing.assert_allclose(np.cross(nadir[:, :, 2], place), 0.0, atol=1e-12)
    np.testing.assert_allclose(np.einsum("ni,ni->n", nadir[:, :, 1], velocity), 0.0, atol=1e-12)
    assert np.all(np.einsum("ni,ni->n", nadir[:, :, 0], velocity) > 0)
    np.testing.assert_allclose(np.einsum("ni,ni->n", yaw[:, :, 1], sun), 0.0, atol=1e-12)
    np.testing.assert_allclose(np.cross(sun_frames(sun)[:, :, 2], sun), 0.0, atol=1e-12)


def test_offsets_are_told_from_the_nearest_alignment():
    assert len({tuple(np.round(rotation_matrices(q), 6).ravel()) for q in ALIGNMENTS}) == 24
    turn = np.deg2rad([2.0, -3.0, 1.0])
    for k in (0, 7, 23):
        found, aligned = offset(multiply(exp_so3(turn), ALIGNMENTS[k]))
        np.testing.assert_allclose(found, turn, atol=1e-9)
        np.testing.assert_allclose(np.abs(aligned @ ALIGNMENTS[k]), 1.0)
    angle, axis = tilt(exp_so3(np.array([0.1 - np.pi / 2, 0.0, 0.0])))
    assert (angle, axis) == (pytest.approx(0.1), 4)  # -y of the body lies 0.1 from z of the reference


@pytest.mark.parametrize("law", [log_aligned_or_any, log_axis_along_z])
def test_priors_of_orientation_have_the_mass_one(law):
    q = np.random.default_rng(1).standard_normal((60_000, 4))
    density = np.exp(law(q / np.linalg.norm(q, axis=1, keepdims=True)))
    assert np.mean(density) * 8 * np.pi**2 == pytest.approx(1.0, abs=0.1)


@pytest.mark.parametrize("mode", ["yaw_steering", "sun_pointing"])
def test_each_mode_is_told_from_the_others(mode):
    rng = np.random.default_rng(3)
    times = np.linspace(0.0, 100.0, 60)
    references = draw_references(rng, times, 700.0)
    frames = seen_stream(rng, times, draw_orientations(rng, mode, times, references)).frames
    found = attitude_modes(frames, references, fit_pass(frames, float(np.deg2rad(25.0))))
    assert found.best == mode
    assert sum(found.probabilities.values()) == pytest.approx(1.0)

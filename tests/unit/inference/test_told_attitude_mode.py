"""An attitude mode that was told weighs the modes of an answer, and nothing that is carried on."""

from dataclasses import replace

import numpy as np
import pytest
from held_mixture import mixture

from service.inference.held import Held, believed
from service.inference.pose import exp_so3, from_matrices, multiply, rotation_matrices
from service.inference.spin.alignment import ALIGNMENTS

REFERENCE = exp_so3(np.array([0.4, -0.7, 1.1]))
MODES = ("nadir_pointing", "yaw_steering", "sun_pointing")


def held(mode: str, reference: np.ndarray = REFERENCE) -> Held:
    return Held(mode, tuple(reference.tolist()))


@pytest.mark.parametrize("mode", MODES)
def test_it_says_nothing_of_a_body_that_may_be_any(mode):
    q = np.random.default_rng(1).standard_normal((60_000, 4))
    ratio = np.exp(held(mode).log_ratio(q / np.linalg.norm(q, axis=1, keepdims=True)))
    assert ratio.mean() == pytest.approx(1.0, abs=0.1)
    assert ratio.min() == pytest.approx(0.5, abs=0.01)  # told wrongly, the truth loses a factor of two


@pytest.mark.parametrize("mode", MODES)
def test_every_alignment_is_as_likely_and_five_degrees_cost_half_a_nat(mode):
    at = held(mode).log_ratio(multiply(REFERENCE, ALIGNMENTS))
    np.testing.assert_allclose(at, at[0], atol=1e-9)
    tilted = exp_so3(np.deg2rad([[5.0, 0.0, 0.0]]))  # about the reference's x, across its z
    off = held(mode).log_ratio(multiply(multiply(REFERENCE, tilted), ALIGNMENTS[0]))
    assert at[0] - off[0] == pytest.approx(0.5, abs=0.02)


def test_of_two_poses_that_a_frame_cannot_tell_apart_the_aligned_one_leads():
    two = mixture((0.6, 0.4))  # a radian apart
    told = held("nadir_pointing", two.poses.quaternion[1])
    after = believed(two, told)
    assert np.exp(after.log_weights).sum() == pytest.approx(1.0)
    assert np.exp(after.log_weights[1]) > 0.9
    assert believed(two, None) is two
    same = replace(after, log_weights=two.log_weights)
    for name in ("rates", "covariance", "existence", "paint"):
        assert getattr(same, name) is getattr(two, name)


def test_evidence_of_a_few_nats_overrules_what_was_told_wrongly():
    two = mixture((1 - 1e-6, 1e-6))
    after = believed(two, held("nadir_pointing", two.poses.quaternion[1]))
    assert np.exp(after.log_weights[0]) > 0.99


def test_a_body_on_the_reference_is_aligned_whatever_the_camera_is():
    camera = exp_so3(np.array([1.0, 0.2, -0.5]))
    frame = rotation_matrices(exp_so3(np.array([-0.3, 0.9, 0.1])))  # reference -> GCRF
    reference = from_matrices(rotation_matrices(camera).T @ frame)
    body = from_matrices(rotation_matrices(camera).T @ frame)[None]  # its axes are the reference's
    assert held("yaw_steering", reference).log_ratio(body)[0] > 4

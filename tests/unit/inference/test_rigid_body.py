"""Torque-free bodies: what they keep, and derivatives of their orientations."""

import numpy as np
import pytest

from service.inference.pose import angle_between, conjugate, exp_so3, log_so3, multiply, rotation_matrices
from service.inference.spin.rigid_body import (
    Motions,
    at_other_time,
    inertia,
    moved,
    orientations,
    rates_at,
    shape_of,
    with_derivatives,
)


def body(seed: int, free: bool) -> Motions:
    rng = np.random.default_rng(seed)
    shape = rng.normal(0.0, 0.5, (1, 5)) if free else np.zeros((1, 0))
    return Motions(exp_so3(rng.normal(size=(1, 3))), np.deg2rad(8.0) * rng.normal(size=(1, 3)), shape)


def test_a_free_body_keeps_its_angular_momentum_and_energy_both_ways_in_time():
    motion, at = body(0, True), np.linspace(-200.0, 200.0, 301)
    moments = inertia(motion.shape[0])
    rates = rates_at(motion, at)[0]
    momentum = np.einsum("nij,nj->ni", rotation_matrices(orientations(motion, at)[0]), rates @ moments)
    energy = np.einsum("ni,ij,nj->n", rates, moments, rates)
    np.testing.assert_allclose(momentum, np.broadcast_to(momentum[0], momentum.shape), atol=3e-5)
    np.testing.assert_allclose(energy, energy[0], rtol=2e-4)
    assert np.ptp(rates, axis=0).max() > 0.02  # it does tumble
    before, after = (orientations(motion, at + sign * 0.05) for sign in (-1, 1))
    np.testing.assert_allclose(log_so3(multiply(conjugate(before), after))[0] / 0.1, rates, atol=1e-4)


def test_a_sphere_turns_at_a_constant_rate():
    constant, at = body(1, False), np.linspace(-30.0, 30.0, 50)
    sphere = Motions(constant.quaternion, constant.rate, np.zeros((1, 5)))
    assert angle_between(orientations(constant, at), orientations(sphere, at)).max() < 1e-9


@pytest.mark.parametrize("free", [True, False])
def test_derivatives_are_those_of_the_orientations(free):
    motion, at = body(2, free), np.linspace(-20.0, 40.0, 33)
    q, jacobian = with_derivatives(motion, at)
    for k in range(motion.n_parameters):
        step = 1e-6 * np.eye(motion.n_parameters)[k : k + 1]
        near = [orientations(moved(motion, sign * step), at) for sign in (1, -1)]
        slope = log_so3(multiply(conjugate(near[1]), near[0])) / 2e-6
        np.testing.assert_allclose(jacobian[..., k], slope, atol=1e-3 * np.abs(slope).max())
    np.testing.assert_allclose(q, orientations(motion, at), atol=1e-12)


def test_a_motion_is_the_same_told_at_another_time():
    motion, at = body(3, True), np.linspace(-10.0, 10.0, 21)
    later = at_other_time(motion, 25.0)
    assert angle_between(orientations(later, at - 25.0), orientations(motion, at)).max() < 1e-4


def test_inertia_obeys_the_triangle_and_comes_of_second_moments():
    moments = np.linalg.eigvalsh(inertia(np.random.default_rng(4).normal(0.0, 2.0, (200, 5))))
    assert np.all(moments[:, 0] + moments[:, 1] >= moments[:, 2])
    masses = np.diag([3.0, 2.0, 0.5])
    found = inertia(shape_of(masses))
    np.testing.assert_allclose(found / found[0, 0], np.diag([2.5, 3.5, 5.0]) / 2.5, atol=1e-12)

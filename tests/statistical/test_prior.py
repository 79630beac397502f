"""The uniform prior by its moments and its distributions (fixed seeds).

Bounds are at a level of 1e-5 or five standard errors: a right implementation fails for one seed in some 10^5.
"""

import numpy as np
from scipy import stats

from service.inference.articulation import Articulation, Joint, Stage
from service.inference.domain import Domain, sample_prior
from service.inference.params import PriorParams
from service.inference.pose import angle_between, rotation_matrices

LEVEL = 1e-5
COUNT = 40_000
HINGE = Joint("hinge", "revolute", -20, 70, 0.0, (Stage("revolute", ("bus",), (0, 0, 1)),))
DOMAIN = Domain(320, 200, 4.0, Articulation(("bus",), (HINGE,)), PriorParams())


def check_uniform_on_so3(quaternion: np.ndarray) -> None:
    """E R = 0 and E R_ij R_kl = (1/3) d_ik d_jl: with entries of variance 1/3; the angle has density (1 - cos) / pi."""
    n = len(quaternion)
    entries = rotation_matrices(quaternion).reshape(n, 9)
    error = 5 / np.sqrt(n)
    np.testing.assert_allclose(entries.mean(axis=0), 0, atol=error * np.sqrt(1 / 3))
    np.testing.assert_allclose(entries.T @ entries / n, np.eye(9) / 3, atol=error * np.sqrt(1 / 5))
    angle = angle_between(quaternion, np.array([1.0, 0, 0, 0]))
    assert stats.kstest(angle, lambda a: (a - np.sin(a)) / np.pi).pvalue > LEVEL
    for column in (0, 4, 8):  # each entry of a uniform rotation is uniform on [-1, 1]
        assert stats.kstest(entries[:, column], stats.uniform(-1, 2).cdf).pvalue > LEVEL


def test_the_prior_is_uniform_in_every_coordinate():
    poses = sample_prior(np.random.Generator(np.random.Philox(7)), DOMAIN, COUNT)
    check_uniform_on_so3(poses.quaternion)
    low, high = np.exp(DOMAIN.log_scale_bounds)
    for values, start, stop in (
        (poses.position[:, 0], 0, 320),
        (poses.position[:, 1], 0, 200),
        (np.exp(poses.log_scale), low, high),
        (poses.joints[:, 0], -20, 70),
    ):
        assert stats.kstest(values, stats.uniform(start, stop - start).cdf).pvalue > LEVEL
    coordinates = np.column_stack([poses.position, np.exp(poses.log_scale), poses.joints, poses.quaternion])
    off_diagonal = np.corrcoef(coordinates.T) - np.eye(coordinates.shape[1])
    assert np.abs(off_diagonal).max() < 5 / np.sqrt(COUNT)


def test_euler_angles_of_the_prior_are_not_uniform():
    """The sine of the pitch is; a prior uniform in the angles would crowd the poles."""
    poses = sample_prior(np.random.Generator(np.random.Philox(8)), DOMAIN, COUNT)
    sine = -rotation_matrices(poses.quaternion)[:, 2, 0]
    assert stats.kstest(sine, stats.uniform(-1, 2).cdf).pvalue > LEVEL
    assert stats.kstest(np.arcsin(sine), stats.uniform(-np.pi / 2, np.pi).cdf).pvalue < 1e-50

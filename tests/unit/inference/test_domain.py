"""The prior's bounds."""

import numpy as np
import pytest

from service.inference.articulation import Articulation, Joint, Stage
from service.inference.domain import Domain, sample_prior
from service.inference.params import PriorParams
from service.inference.state import Poses


def joint(name: str, kind: str, minimum: float, maximum: float) -> Joint:
    return Joint(name, kind, minimum, maximum, 0.0, (Stage(kind, ("bus",), (0, 0, 1)),))


JOINTED = Articulation(
    ("bus",),
    (joint("boom", "prismatic", 0.5, 2.0), joint("panel", "revolute", 0, 360), joint("dish", "revolute", -30, 40)),
)


def domain(articulation: Articulation = JOINTED, prior: PriorParams | None = None) -> Domain:
    return Domain(320, 200, 4.0, articulation, prior or PriorParams())


def one(x=160.0, y=100.0, span_px=100.0, joints=(1.0, 10.0, 0.0)) -> Poses:
    return Poses(np.array([[1.0, 0, 0, 0]]), np.array([[x, y]]), np.log([span_px / 8]), np.array([joints], dtype=float))


def test_the_least_scale_spans_a_tenth_of_the_image():
    """A sphere of radius 4 is 8 units across: 20 px of a shorter side of 200 px."""
    low, high = domain().log_scale_bounds
    assert 8 * np.exp(low) == pytest.approx(20)
    assert 8 * np.exp(high) >= 200


def test_the_bounds_follow_the_parameters():
    low, high = domain(prior=PriorParams(0.25, 2.0)).log_scale_bounds
    assert 8 * np.exp(low) == pytest.approx(50)
    assert high - domain().log_scale_bounds[1] == pytest.approx(np.log(2))


@pytest.mark.parametrize(
    ("pose", "inside"),
    [
        (one(), True),
        (one(x=0.0, y=200.0), True),
        (one(x=-0.01), False),
        (one(y=200.01), False),
        (one(span_px=20.1), True),
        (one(span_px=19.9), False),
        (one(span_px=1e4), False),
        (one(joints=(0.5, 10, 40)), True),
        (one(joints=(0.49, 10, 0)), False),
        (one(joints=(1.0, 10, 40.1)), False),
        (one(joints=(1.0, 700, 0)), True),  # turns all the way round: every angle is within
        (one(x=float("nan")), False),
    ],
)
def test_contains(pose, inside):
    assert domain().contains(pose).tolist() == [inside]


def test_a_rigid_body_has_no_joints_to_bound():
    rigid = domain(Articulation(("bus",)))
    pose = Poses(np.array([[1.0, 0, 0, 0]]), np.array([[1.0, 1.0]]), np.log([10.0]), np.zeros((1, 0)))
    assert rigid.n_tangent == 6
    assert rigid.contains(pose).tolist() == [True]
    assert rigid.wrap(pose) is pose


def test_wrap_brings_full_turns_back_and_leaves_the_rest():
    wrapped = domain().wrap(one(joints=(9.0, -10.0, -50.0)))
    np.testing.assert_allclose(wrapped.joints, [[9.0, 350.0, -50.0]])
    assert domain().wrapping.tolist() == [False, True, False]


def test_the_prior_lies_within_its_bounds():
    poses = sample_prior(np.random.Generator(np.random.Philox(1)), domain(), 5000)
    assert len(poses) == 5000
    assert domain().contains(poses).all()
    np.testing.assert_allclose(np.linalg.norm(poses.quaternion, axis=1), 1)


def test_known_bounds_of_the_scale_stand_for_the_extents():
    wide = Domain(200, 100, 2.0, Articulation(("bus",)), PriorParams())
    known = Domain(200, 100, 2.0, Articulation(("bus",)), PriorParams(), (3.0, 4.0))
    assert known.log_scale_bounds == pytest.approx(np.log([3.0, 4.0]))
    drawn = np.exp(sample_prior(np.random.default_rng(1), known, 500).log_scale)
    assert 3.0 <= drawn.min() < drawn.max() <= 4.0
    assert known.log_volume < wide.log_volume

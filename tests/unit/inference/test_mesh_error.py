"""Bodies that are not quite their mesh: spreads, and what evidence is worth."""

from dataclasses import replace

import numpy as np
import pytest
from held_mixture import mixture

from service.inference.articulation import Articulation, Joint
from service.inference.belief import belief_of_mixture
from service.inference.domain import Domain
from service.inference.filters.answer import drawn, mode_spread
from service.inference.filters.status import told_existence
from service.inference.mesh_error import evidence_trust, mesh_variance, stated, stated_belief
from service.inference.model import prior
from service.inference.model.existence import log_discrepancy_known as known
from service.inference.model.existence import of_this_body
from service.inference.params import PriorParams
from service.inference.smoothed import summarise_belief
from service.inference.state import FilterState

ERROR, RADIUS = 0.05, 2.0


def domain(error: float = ERROR, joints: tuple[Joint, ...] = ()) -> Domain:
    return Domain(144, 144, RADIUS, Articulation((), joints), PriorParams(mesh_error=error))


def hinge(kind: str) -> Joint:
    return Joint("wing", kind, -90.0, 90.0, 0.0, ())


def test_by_how_much_each_axis_is_off():
    joints = hinge("revolute"), hinge("prismatic")
    found = np.sqrt(mesh_variance(np.log([10.0, 20.0]), domain(joints=joints)))
    turn, place = prior.MESH_TURN * ERROR, prior.MESH_PLACE * ERROR * RADIUS
    growth = prior.MESH_GROWTH * ERROR
    for row, scale in zip(found, (10.0, 20.0), strict=True):
        wanted = [*(3 * [turn]), *(2 * [scale * place]), growth, np.rad2deg(turn), place]
        np.testing.assert_allclose(row, wanted)


def test_a_mesh_that_is_right_changes_nothing():
    held = mixture((0.7, 0.3))
    assert stated(held, domain(0.0)) is held
    belief = belief_of_mixture(state_of(held), held)
    assert stated_belief(belief, domain(0.0)) is belief


def test_poses_are_wider_and_rates_are_as_they_were():
    held = mixture((0.7, 0.3))
    wide = stated(held, domain())
    more = wide.covariance - held.covariance
    variance = mesh_variance(held.poses.log_scale, domain())
    for k in range(2):
        np.testing.assert_allclose(more[k], np.diag([*variance[k], *(6 * [0.0])]), atol=1e-12)
    same = replace(wide, covariance=held.covariance)
    assert all(getattr(same, name) is getattr(held, name) for name in ("poses", "rates", "log_weights", "existence"))


def test_spread_particles_and_smoothed_spread_say_so():
    held = mixture((1.0,))
    where = domain()
    wide = stated(held, where)
    narrow, told = mode_spread(held, 0, ()), mode_spread(wide, 0, ())
    off = np.rad2deg(prior.MESH_TURN * ERROR) * np.sqrt(3 * 2)  # three axes; a Student t of 4 is twice its scale
    assert told.orientation_deg == pytest.approx(np.hypot(narrow.orientation_deg, off))
    poses, _ = drawn(np.random.default_rng(2), wide, 20_000, where)
    seen = np.std(poses.position[:, 0])
    assert seen == pytest.approx(told.x_px, rel=0.1)
    belief = belief_of_mixture(state_of(held), held)
    smoothed = summarise_belief(stated_belief(belief, where), (), where, with_rates=False)
    assert smoothed.spread.orientation_deg == pytest.approx(told.orientation_deg, rel=1e-3)
    assert smoothed.spread.x_px == pytest.approx(told.x_px, rel=1e-6)


def test_evidence_counts_for_less_the_less_the_mesh_is_like_the_body():
    trust = [evidence_trust(domain(error)) for error in (0.0, 0.02, prior.MESH_DOUBT, 0.05)]
    assert trust[0] == prior.EVIDENCE_TRUST and trust[2] == pytest.approx(0.5 * trust[0])
    assert trust[1] > 0.7 * trust[0] and trust[3] < 0.1 * trust[0]


def test_a_mesh_that_is_off_asks_for_more_discrepancy_of_its_own():
    assert of_this_body(known(0.02), 0.0) == of_this_body(known(0.02))
    told = [of_this_body(known(0.03), error) for error in (0.0, 0.02, 0.05)]
    assert told == sorted(told) and told[2] > 0.85 > 0.6 > told[0]
    assert of_this_body(known(0.2), ERROR) < 0.5  # another body's all the same
    held = mixture(discrepancy=0.03)
    assert told_existence(held, ERROR)[1] > told_existence(held)[1]


def state_of(held) -> FilterState:
    return FilterState(held.poses, held.log_weights, held.rates, 0, 0.0, "tracking", {}, held)

"""The templates most like a frame."""

from dataclasses import replace

import numpy as np
import pytest
from lit_body import SUN
from lit_search import (
    TOLD,
    bank,
    body,
    off_deg,
    sight_of,
    truth,
)

from service.inference.model import proposing
from service.inference.model.proposing import propose
from service.inference.model.search import make_bank
from service.inference.model.templates import Bank
from service.inference.numerics.priors import PosePrior
from service.inference.pose import angle_between, exp_so3, multiply

pytestmark = pytest.mark.usefixtures("small_banks")


def test_proposals_are_of_the_frame_apart_and_lit():
    at = truth(4, True)
    sight = sight_of(at)
    for wanted in (18, 44):  # squares of pixels, and pixels
        patch = sight.cut(sight.span, wanted)
        some = propose(bank(True), patch, TOLD)
        count = len(some.found)
        assert 50 < count <= 5 * 80
        assert some.suns == pytest.approx(np.tile(SUN, (count, 1)))
        assert (some.found == -np.inf).all()
        near = off_deg(some.poses, at) < 20.0
        assert near.any()
        assert np.median(np.abs(some.poses.position[near] - at.position)) < 6.0
        assert np.median(np.abs(some.poses.log_scale[near] - at.log_scale)) < 0.25


def test_proposals_keep_to_a_told_scale():
    at = truth(4, False)
    sight = sight_of(at)
    patch = sight.cut(sight.span, 18)
    assert patch.binning > 1
    some = propose(bank(False), patch, PosePrior(float(at.log_scale[0]), 0.02, SUN))
    assert np.abs(some.poses.log_scale - at.log_scale).max() < 3 * 0.02 + 0.1


def test_a_later_search_proposes_some_that_were_crowded_out():
    """Other ones each time, most of them the same."""
    sight = sight_of(truth(4, False))
    patch = sight.cut(sight.span, 28.0)

    def proposed(rng: np.random.Generator | None) -> set[tuple[float, ...]]:
        return {tuple(q) for q in propose(bank(False), patch, TOLD, rng=rng).poses.quaternion}

    first, later, other = proposed(None), *(proposed(np.random.default_rng(seed)) for seed in (1, 2))
    assert 0.5 < len(first & later) / len(first) < 0.9
    assert later - first and other - first and later != other


def test_without_a_told_sun_a_template_stands_for_a_body_turned_together_with_its_sun(monkeypatch):
    """Of one template alone, and a frame that shows it turned by an eighth about the line of sight."""
    monkeypatch.setattr(proposing, "_TURNED", 16)
    at, turn = truth(6, False), np.deg2rad(45.0)
    whole = make_bank(body(False), PosePrior())
    apart = np.rad2deg(angle_between(whole.poses.quaternion, at.quaternion[0]))
    one = slice(int(np.argmin(apart)), int(np.argmin(apart)) + 1)
    few = Bank(whole.suns[one], whole.poses[one], whole.pictures[:, one])
    about = exp_so3(np.array([0.0, 0.0, turn]))
    cosine, sine = np.cos(turn), np.sin(turn)
    x, y, z = few.suns[0]
    sun = np.array([cosine * x - sine * y, sine * x + cosine * y, z])
    turned = replace(at, quaternion=multiply(about[None], few.poses.quaternion))
    sight = sight_of(turned, sun=sun)
    found = propose(few, sight.cut(sight.span, 28.0), PosePrior())
    assert off_deg(found.poses, turned).min() < 1e-3
    best = int(np.argmin(off_deg(found.poses, turned)))
    assert found.suns[best] == pytest.approx(sun, abs=1e-6)
    assert np.linalg.norm(found.poses.position[best] - turned.position[0]) < 3.0
    assert len(propose(few, sight.cut(sight.span, 28.0), TOLD).found) <= 5  # kinds: it is not turned

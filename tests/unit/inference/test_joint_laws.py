"""Joints that stand still, follow the Sun or do neither: told from each other, by as much as the frames show."""

import numpy as np
import pytest

from service.inference.spin.joint_laws import JointLaw, Seen, SeenJoint, joint_law

SPAN, FRAMES, SIGMA, OFFSET = 360.0, 60, 1.5, 10.0


def seen(rng, law: str, counted: float = 0.3, sun_turns: float = 20.0) -> tuple[JointLaw, float]:
    """A joint drawn from a law's prior, its Sun turning by some degrees about the hinge; and the constant it has."""
    sun = rng.uniform(-180, 180) + np.linspace(0, sun_turns, FRAMES)  # value at which the panel faces it
    if law == "still":
        constant = rng.uniform(-180, 180)
        value = np.full(FRAMES, constant)
    elif law == "sun_tracking":
        constant = rng.normal(0, OFFSET)
        value = sun + constant
    else:
        constant, value = np.nan, rng.uniform(-180, 180, FRAMES)
    value = value + SIGMA * rng.standard_t(4, FRAMES)
    wrong = rng.random(FRAMES) < 0.05
    value[wrong] = rng.uniform(-180, 180, int(wrong.sum()))
    lacks = sun - value
    lacks -= 180 * np.round(lacks / 180)
    widths = np.full(FRAMES, SIGMA)
    return joint_law(
        SeenJoint("panel", Seen(value, widths, 360.0), Seen(lacks, widths, 180.0), SPAN, OFFSET), counted
    ), constant


@pytest.mark.parametrize("law", ["still", "sun_tracking", "neither"])
def test_each_is_told_from_the_others(law):
    rng = np.random.default_rng(4)
    for _ in range(12):
        found, constant = seen(rng, law)
        assert found.best == law and sum(found.probabilities.values()) == pytest.approx(1.0)
        if law != "neither":
            value, sigma = found.constants[law]
            off = (value - constant + 180) % 360 - 180
            assert abs(off) < 5 * sigma and 0.1 < sigma < 1.0


def test_probabilities_are_those_of_the_truth_where_the_sun_stands_still():
    """Then a joint that tracks stands still, too: only how near the Sun it is tells."""
    rng, told, right = np.random.default_rng(5), [], []
    for _ in range(150):
        law = str(rng.choice(["still", "sun_tracking"]))
        found, _ = seen(rng, law, sun_turns=0.0)
        told.append(max(found.probabilities.values()))
        right.append(found.best == law)
    assert np.mean(told) == pytest.approx(np.mean(right), abs=0.1)
    assert 0.8 < np.mean(right) < 1.0


def test_frames_that_err_alike_count_less():
    wide = seen(np.random.default_rng(6), "still", counted=0.05)[0].constants["still"][1]
    narrow = seen(np.random.default_rng(6), "still", counted=0.8)[0].constants["still"][1]
    assert wide == pytest.approx(4 * narrow, rel=0.3)


def test_a_hinge_of_no_half_turn_has_one_side():
    """Its values are no circle: 80 degrees from the Sun is 80 degrees, not -100."""
    values = Seen(np.full(20, 40.0), np.full(20, 1.0))
    found = joint_law(SeenJoint("flap", values, Seen(np.full(20, 80.0), np.full(20, 1.0)), 90.0, OFFSET), 0.5)
    assert found.best == "still" and found.probabilities["sun_tracking"] < 1e-6
    assert found.constants["still"][0] == pytest.approx(40.0, abs=0.1)

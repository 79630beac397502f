"""Spin over several passes: turns are counted where that is safe, and the trend of the period is known so well."""

from dataclasses import replace

import numpy as np
import pytest

from service.inference.pose import exp_so3, multiply
from service.inference.spin.passes import PassSpin, spin_of

AXIS = np.array([0.6, -0.64, 0.48])
DAY = 86_400.0


def passes(rng, times, rate, change=0.0, orientation_deg=0.3, rate_share=2e-3) -> list[PassSpin]:
    """A body that turns about ``AXIS``, seen at these times: rates and orientations err as they state."""
    start = exp_so3(rng.normal(size=3))
    found = []
    for t in times:
        phase = rate * t + 0.5 * change * t**2
        q = multiply(exp_so3(AXIS * (phase % (2 * np.pi))), start)
        q = multiply(exp_so3(np.deg2rad(orientation_deg) / np.sqrt(3) * rng.normal(size=3)), q)
        sigma = rate_share * rate
        seen = rate + change * t + sigma * rng.normal()
        axis = AXIS + np.deg2rad(0.5) * rng.normal(size=3)
        axis = axis / np.linalg.norm(axis)
        found.append(PassSpin(t, q, np.deg2rad(orientation_deg) / np.sqrt(3), seen, sigma, axis, np.deg2rad(0.7)))
    return found


def week(rng) -> np.ndarray:
    """Twenty passes: two or three a day, one orbit apart."""
    days = [day * DAY + 5_900.0 * np.arange(3) + rng.uniform(0, 300, 3) for day in range(7)]
    return np.concatenate(days)[:20]


def test_a_slow_change_of_the_period_over_twenty_passes():
    """As Envisat's: two minutes a turn, growing; what is counted makes the period a thousand times surer."""
    off, relative = [], []
    for seed in range(60):
        rng = np.random.default_rng(seed)
        rate = 2 * np.pi / 120.0
        change = -rate * 3e-4 / DAY  # 36 ms a day
        times = week(rng)
        found = spin_of(passes(rng, times, rate, change))
        true = rate + change * found.time_s
        assert all(one.turns is not None for one in found.gaps)
        off.append([(found.rate - true) / found.rate_sigma, (found.change - change) / found.change_sigma])
        relative.append(abs(found.rate / true - 1))
        assert found.period_s[0] == pytest.approx(120.0, rel=0.01)
        assert found.period_change[0] == pytest.approx(-change * 2 * np.pi / rate**2, rel=0.2)
    within = np.mean(np.abs(off) < 1.645, axis=0)
    assert np.all(within > 0.8)
    assert np.all(within < 0.98)
    assert np.median(relative) < 1e-6


def test_turns_that_cannot_be_counted_are_told_so_and_rates_still_add_up():
    rng = np.random.default_rng(1)
    times = 10 * DAY * np.arange(5)
    found = spin_of(passes(rng, times, np.deg2rad(3.0), rate_share=0.02))
    assert [one.turns for one in found.gaps] == [None] * 4
    assert all(one.sigma_turns > 1 for one in found.gaps)
    assert found.rate == pytest.approx(np.deg2rad(3.0), abs=4 * found.rate_sigma)
    assert found.rate_sigma < 0.02 * np.deg2rad(3.0)


def test_counting_begins_with_the_shortest_gap():
    """Half a day alone is ambiguous by some turns; with two passes of one orbit apart it is not."""
    rng = np.random.default_rng(2)
    rate, share = np.deg2rad(1.0), 4e-3
    far = spin_of(passes(rng, [0.0, 43_200.0], rate, rate_share=share))
    near = spin_of(passes(rng, [0.0, 1_800.0, 8_000.0, 43_200.0], rate, rate_share=share))
    assert far.gaps[0].turns is None
    assert [round(one.turns) for one in near.gaps] == [5, 17, 98]
    assert near.rate == pytest.approx(rate, rel=1e-5)


def test_a_rate_told_about_the_other_end_of_the_axis_is_the_same():
    rng = np.random.default_rng(3)
    told = passes(rng, [0.0, 3_000.0, 6_000.0], np.deg2rad(1.0))
    flipped = replace(told[1], rate=-told[1].rate, axis=-told[1].axis)
    found, same = spin_of(told), spin_of([told[0], flipped, told[2]])
    assert same.rate == pytest.approx(found.rate)


def test_what_no_turn_about_the_axis_explains_is_told_as_swing():
    rng = np.random.default_rng(4)
    one, other = passes(rng, [0.0, 1_000.0], np.deg2rad(1.0), orientation_deg=0.01)
    away = replace(other, quaternion=multiply(exp_so3(0.3 * np.array([0.8, 0.6, -0.2])), other.quaternion))
    assert spin_of([one, other]).gaps[0].swing < np.deg2rad(1.0)
    assert spin_of([one, away]).gaps[0].swing > 0.2

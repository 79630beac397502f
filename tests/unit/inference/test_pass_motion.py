"""Motions of synthetic passes: found, decided, or honestly kept; and whether their spreads hold."""

from collections import Counter

import numpy as np
import pytest
from scipy.stats import chi2

from service.bench.motion_streams import StreamPlan, draw_errors, draw_stream
from service.inference.pose import exp_so3, multiply
from service.inference.spin.basins import inertia_ratios, same_course, told, turning_rate
from service.inference.spin.climb import MotionPrior
from service.inference.spin.fit import fit_pass, weighed
from service.inference.spin.frames import PassFrames, pass_frames
from service.inference.spin.noise import LASTS_S, SHARES
from service.inference.spin.rigid_body import Motions, orientations

ANY = float(np.deg2rad(25.0))


def stream(motion: Motions, times: np.ndarray, sigma_deg: float, rng, **alike: float) -> PassFrames:
    """One mode a frame."""
    width = np.deg2rad(sigma_deg)
    smooth = bool(alike.get("smooth", False))
    errors = draw_errors(rng, times, alike.get("stays", 0.0), alike.get("lasts_s", 1.0), smooth=smooth) * width
    q = multiply(orientations(motion, times)[0], exp_so3(errors))
    spread = width**2 * np.eye(3)[None]
    return pass_frames(times, list(q[:, None]), [spread] * len(times), [np.ones(1)] * len(times))


def constant(rate_deg_s: float, seed: int = 0) -> Motions:
    rng = np.random.default_rng(seed)
    axis = rng.normal(size=(1, 3))
    rate = np.deg2rad(rate_deg_s) * axis / np.linalg.norm(axis)
    return Motions(exp_so3(rng.normal(size=(1, 3))), rate, np.zeros((1, 0)))


@pytest.mark.parametrize("tumbling", [False, True])
def test_a_pass_with_twins_outliers_and_alike_errors_is_found_again(tumbling):
    plan = StreamPlan(frames=80, rates_deg_s=(3.0, 3.0), least_nutation_deg=15.0)
    one = draw_stream(np.random.default_rng(5), plan, tumbling=tumbling)
    found = fit_pass(one.frames, ANY)
    lead = found.basins[0]
    assert found.model == lead.model == ("tumbling" if tumbling else "constant_rate")
    assert found.probability_of(found.model) > 0.95
    assert same_course(lead.motion, one.truth, found.half_span_s)
    assert np.rad2deg(np.linalg.norm(lead.motion.rate - one.truth.rate)) < 0.1
    if tumbling:
        ratios = told(lead, inertia_ratios)
        assert np.all(np.abs(ratios.value - inertia_ratios(one.truth)) < 4 * ratios.sigma)


def test_spreads_hold_when_truth_and_errors_are_drawn_from_their_priors():
    """Simulation-based calibration (Talts et al. 2018) of the rate, from the truth's own basin."""
    rng, inside = np.random.default_rng(1), []
    for seed in range(30):
        share = float(rng.choice((0.0, *SHARES)))
        alike = {"stays": share, "lasts_s": float(rng.choice(LASTS_S)), "smooth": bool(seed % 2)}
        truth, times = constant(2.0, seed), np.linspace(-10.0, 10.0, 60)
        basin = weighed(stream(truth, times, 1.0, rng, **alike), truth, MotionPrior(ANY, np.zeros(5), 1.0), 0.0)
        off = basin.motion.rate[0] - truth.rate[0]
        inside.append(chi2.cdf(off @ np.linalg.solve(basin.covariance[3:6, 3:6], off), 3))
    assert 0.26 < np.mean(np.array(inside) < 0.5) < 0.74  # 2.6 standard deviations of 30 draws
    assert np.mean(np.array(inside) < 0.9) > 0.75


def test_frames_that_repeat_their_errors_are_not_told_as_many():
    times, truth = np.linspace(-10.0, 10.0, 200), constant(2.0)
    prior = MotionPrior(ANY, np.zeros(5), 1.0)
    alone, alike = (
        weighed(stream(truth, times, 1.0, np.random.default_rng(2), stays=share, lasts_s=2.0), truth, prior, 0.0)
        for share in (0.0, 0.8)
    )
    assert alike.independent < 0.3 * alone.independent
    assert np.trace(alike.covariance[3:6, 3:6]) > 2 * np.trace(alone.covariance[3:6, 3:6])


def test_rates_that_frames_at_even_times_cannot_tell_are_all_kept():
    """A whole turn more or less between two frames: 10 and 20 degrees per second, either way round."""
    found = fit_pass(
        stream(constant(10.0, 3), np.arange(5) * 12.0, 1.0, np.random.default_rng(3)), rate_sigma=np.deg2rad(8.0)
    )
    of_rate: Counter[int] = Counter()
    for p, basin in found.courses():
        of_rate[round(float(np.rad2deg(np.linalg.norm(basin.motion.rate))))] += p
    assert of_rate[10] == pytest.approx(2 / 3, abs=0.1)  # of unknown magnitude: 1 / w
    assert of_rate[20] == pytest.approx(1 / 3, abs=0.1)


def test_a_body_that_does_not_turn_is_told_without_a_law():
    times = np.linspace(0.0, 10.0, 30)
    found = fit_pass(stream(constant(0.0), times, 1.0, np.random.default_rng(4)), ANY)
    rate = told(found.basins[0], turning_rate)
    assert rate.value[0] < 4 * rate.sigma[0]
    assert found.probability_of("tumbling") == pytest.approx(0.25, abs=0.1)  # as before the frames


def test_modes_of_a_symmetric_body_are_one_motion():
    turn = np.array([0.0, 0.0, 0.0, 1.0])
    times, truth, rng = np.linspace(-5.0, 5.0, 40), constant(6.0, 6), np.random.default_rng(6)
    one = stream(truth, times, 1.0, rng)
    swapped = np.where(rng.random((40, 1, 1)) < 0.5, one.quaternion, multiply(one.quaternion, turn))
    both = np.concatenate([swapped, multiply(swapped, turn)], axis=1)
    root = np.concatenate([one.root] * 2, axis=1)
    frames = PassFrames(times, both, root, np.full((40, 2), -np.log(2.0)), 1, np.zeros(40, np.intp))
    found = fit_pass(frames, ANY, rotations=[turn])
    assert len(found.courses()) == 1
    assert found.basins[0].explained > 0.9

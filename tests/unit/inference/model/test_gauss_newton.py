"""Poses at their best: slope and curvature against differences of the posterior, climbs, joints, Sun, censoring."""

from dataclasses import replace

import numpy as np
import pytest
from lit_body import FINEST, QUALITY, SUN, VIEW, lit_body, pose, scene, seen, shares
from scipy.optimize import least_squares

from service.inference.model.derivatives import across, steps_of
from service.inference.model.drawing import Quality
from service.inference.model.likelihood import ROUNDS
from service.inference.model.paint import unlearnt
from service.inference.model.scene import Scene, sky_slopes
from service.inference.model.spread import spread
from service.inference.numerics.curvature import eliminated, paint_variance, scale_seen, slopes_of, systems_of
from service.inference.numerics.gauss_newton import _look, _moved, ascend, within
from service.inference.numerics.hill import Hill, Refined
from service.inference.numerics.priors import Believed, PosePrior
from service.inference.pose import concatenate, local, retract
from service.inference.state import Poses

SIGMA = 4.0
SMOOTH = Quality(supersample=8, shadow_px=512, gloss=())


def frame(seed: int = 1, gain: float = 700.0, gloss: float = 0.15, **others) -> Scene:
    image = seen(pose(), shares(lit_body(), gain, gloss=gloss))
    image = image + np.random.default_rng(seed).normal(0, SIGMA, image.shape)
    return scene(image, SIGMA, **({"low_pass": FINEST} | others))


def hill(given: Scene, sun=SUN, sun_deg: float = 1.0, **others) -> Hill:
    told = PosePrior(towards_sun=sun, sun_sigma=np.deg2rad(sun_deg))
    return Hill(given, lit_body(), VIEW, told, **({"quality": QUALITY} | others))


def climbed(on: Hill, start: Poses, sun=SUN, steps: int = 12) -> Refined:
    return ascend(on, start, sun[None].copy(), steps=steps)[0]


def moved(*step: float) -> Poses:
    return retract(pose(), np.array([step]))


def profile(on: Hill, at: Poses, sun: np.ndarray, coefficients: np.ndarray, fit) -> float:
    """Log posterior of a pose at fixed weights, the light at its best for them: by another optimiser, in double."""
    drawn = on.drawing.planes(at, sun, on.view, on.quality)
    blurred = spread(drawn, on.scene.point_spread, on.scene.smoothing)[0].astype(float)
    n = on.drawing.n_groups
    weight, precision = np.sqrt(fit.weight.astype(float)), np.sqrt(fit.precision)
    gain = coefficients[0] / np.exp(fit.deviation[0])
    free = np.delete(np.arange(n + 9), n + 2)  # the sky hides nothing here

    def rest(x: np.ndarray) -> np.ndarray:
        bright = np.exp(x[n])
        grows = np.append(coefficients[:n] * np.exp(x[:n]), coefficients[n] + gain * x[n + 1]) * bright
        here = np.append(grows, coefficients[n + 1 :] + np.exp(on.scene.gain) * x[-3:])
        level = fit.deviation[-6:-3] + x[-6:-3]
        image = np.tensordot(here, blurred, 1) + np.tensordot(level, sky_slopes(on.scene.side), 1)
        prior = precision * fit.deviation
        prior[free] += precision[free] * x
        return np.concatenate([(weight * (on.scene.data - image)).ravel(), prior])

    found = least_squares(rest, np.zeros(n + 8), method="lm", x_scale=1 / precision[free])
    apart = np.linalg.norm(sun - on.told.towards_sun) / on.told.sun_sigma
    return -found.cost - 0.5 * apart**2


def test_slope_and_curvature_are_those_of_the_posterior_at_fixed_weights():
    """Along every coordinate and a few more directions, a little beside the top."""
    on = hill(frame(gain=1200.0, gloss=0.0), quality=SMOOTH, rounds=20, difference=0.4)
    sun = SUN + 0.01 * across(SUN)[0]
    sun /= np.linalg.norm(sun)
    start = moved(0.004, -0.005, 0.004, 0.06, -0.05, 0.002, 1.0)
    fits, _ = _look(on, start, sun[None])
    systems = systems_of(on, start, sun[None], fits, slopes_of(on, start, sun[None], fits))
    curvature, slope, stated = (one[0] for one in systems)
    assert stated == pytest.approx(curvature / scale_seen(fits[0].chi2), rel=0.02, abs=0.02 * np.abs(curvature).max())
    turn, joint = steps_of(on.drawing, on.view, on.difference, start)
    step = np.array([turn[0]] * 3 + [on.difference] * 2 + [turn[0], joint[0, 0], 0.03, 0.03])
    directions = np.vstack([np.eye(9), np.random.default_rng(3).normal(size=(3, 9)) / 3]) * 0.5 * step
    for direction in directions:
        value = []
        for sign in (-1, 0, 1):
            there, suns = _moved(start, sun[None], sign * direction[None], on)
            value.append(profile(on, there, suns[0], fits[0].coefficients, fits[0]))
        wanted = direction @ curvature @ direction
        assert -(value[0] - 2 * value[1] + value[2]) == pytest.approx(wanted, rel=0.05, abs=10.0)
        assert 0.5 * (value[2] - value[0]) == pytest.approx(slope @ direction, abs=0.03 * wanted + 10.0)


@pytest.mark.parametrize("sun_free", [True, False])
def test_the_device_eliminates_the_light_as_its_twin_does(sun_free):
    on = replace(hill(frame()), sun_free=sun_free)
    several, suns = concatenate(pose(), moved(0.02, -0.03, 0.01, 0.5, -0.4, 0.02, 3.0), pose()), np.tile(SUN, (3, 1))
    fits = [*_look(on, several[:2], suns[:2])[0], *_look(on, several[2:], suns[2:])[0]]  # told by two launches
    slopes = slopes_of(on, several, suns, fits)
    known = np.abs(np.random.default_rng(5).normal(size=(3, len(fits[0].coefficients) - 4))) * 0.2
    for paint in (None, known):
        found = on.drawing.slopes.systems(slopes, [fit.row for fit in fits], paint)
        wanted = eliminated(fits, slopes, paint)
        size = np.sqrt(np.einsum("nii->ni", wanted[0]))
        for one, other in zip(found[:3], wanted[:3], strict=True):
            assert other.any() and (np.abs(one - other) < 5e-5 * size[:, :, None] * size[:, None]).all()
        assert (np.abs(found[3] - wanted[3]) < 5e-5 * size).all()


def test_paint_is_as_unsure_as_the_joint_normal_of_light_and_pose_says():
    on = hill(frame())
    fit = _look(on, pose(), SUN[None])[0][0]
    slopes = slopes_of(on, pose(), SUN[None], [fit])[0]
    n, firm = len(fit.lit), 1e2 * np.eye(len(slopes))
    flat = np.concatenate([fit.columns, slopes[:, *fit.window]]).reshape(-1, fit.columns[0].size).astype(float)
    joint = (flat * fit.weight[fit.window].ravel()) @ flat.T
    joint[: len(fit.normal), : len(fit.normal)] = fit.normal
    joint[len(fit.normal) :, len(fit.normal) :] += firm
    known = np.delete(joint, n, axis=0)
    covariance = np.linalg.inv(np.delete(known, n, axis=1))
    rest = len(fit.normal) - 1
    alone = np.diag(np.linalg.inv(np.delete(np.delete(fit.normal, n, axis=0), n, axis=1)))[:n]
    found = paint_variance(fit, slopes, covariance[rest:, rest:])
    assert found[fit.lit] == pytest.approx(np.diag(covariance)[:n], rel=1e-3)
    assert (found[fit.lit] > alone).all() and np.isinf(np.delete(found, fit.lit)).all()


@pytest.mark.parametrize("turn", [(0.035, 0, 0), (0, 0.035, 0), (0, 0, 0.035), (-0.02, 0.02, -0.02)])
def test_from_two_degrees_off_a_pose_comes_back(turn):
    found = climbed(hill(frame(gain=300.0)), moved(*turn, 1.0, -0.8, 0.03, 4.0))  # noise above the drawing's steps
    error = local(pose(), found.pose)[0]
    assert np.rad2deg(np.linalg.norm(error[:3])) < 0.6
    assert np.abs(error[3:5]).max() < 0.1
    assert abs(error[5]) < 0.005
    assert error @ np.linalg.solve(found.covariance, error) < 30.0  # of a chi-square of 7
    assert found.fit.chi2 == pytest.approx(1.0, abs=0.2)


def test_poses_climb_together_as_each_alone_and_nothing_given_is_changed():
    on, starts = hill(frame()), [moved(0.03, 0, 0, 0, 0, 0, 3.0), moved(0, -0.03, 0.02, 0.5, 0, 0, -3.0)]
    both = Poses(*(np.concatenate([getattr(s, name) for s in starts]) for name in Poses.__dataclass_fields__))
    kept = local(both, both)
    found = ascend(on, both, np.tile(SUN, (2, 1)), steps=6)
    assert np.array_equal(local(both, both), kept)
    for one, start in zip(found, starts, strict=True):
        alone = climbed(on, start, steps=6)
        assert one.log_posterior == pytest.approx(alone.log_posterior, abs=1e-2)
        assert local(alone.pose, one.pose) == pytest.approx(0.0, abs=1e-4)


def test_the_suns_given_are_not_changed():
    suns = SUN[None].copy()
    ascend(hill(frame()), moved(0.03, 0, 0, 0, 0, 0, 3.0), suns, steps=6)
    assert np.array_equal(suns[0], SUN)


def test_a_climb_never_ends_lower_and_no_steps_stay():
    on, start = hill(frame()), moved(0.3, -0.2, 0.1, 3, 3, 0.1, 40.0)
    before = climbed(on, start, steps=0)
    assert local(start, before.pose) == pytest.approx(0.0, abs=1e-9)
    assert climbed(on, start, steps=1).log_posterior > before.log_posterior
    assert np.isnan(ascend(on, start, SUN[None].copy(), steps=0, covariance="none")[0].covariance).all()


@pytest.mark.parametrize("off", [-9.0, 6.0])
def test_a_joint_turns_to_where_it_is(off):
    found = climbed(hill(frame()), moved(0.01, 0, 0, 0, 0, 0, off))
    sigma = np.sqrt(found.covariance[6, 6])
    assert abs(found.pose.joints[0, 0] - 35.0) < min(4 * sigma, 3.0)


def test_joints_wrap_where_they_turn_all_the_way_and_stop_where_not():
    drawing = lit_body()
    joint = drawing.articulation.joints[0]
    assert within(drawing, np.array([[190.0], [-190.0], [20.0]]))[:, 0] == pytest.approx([-170.0, 170.0, 20.0])
    short = replace(drawing, articulation=replace(drawing.articulation, joints=(replace(joint, minimum=-40.0),)))
    assert within(short, np.array([[190.0], [-60.0], [20.0]]))[:, 0] == pytest.approx([180.0, -40.0, 20.0])


def test_a_sun_told_wrong_goes_towards_the_truth_as_far_as_its_prior_allows():
    """Told 3 degrees beside: the tighter the prior, the nearer to what was told. 5 degrees pass for a light from one
    side on a body of three surfaces."""
    axis = across(SUN)[0]
    told = np.cos(np.deg2rad(3)) * SUN + np.sin(np.deg2rad(3)) * axis
    given, left, gone = frame(), [], []
    for sun_deg in (0.02, 0.5, 5.0):
        found = climbed(hill(given, told, sun_deg), pose(), told, steps=20)
        left.append(np.rad2deg(np.linalg.norm(found.sun - SUN)))
        gone.append(np.rad2deg(np.linalg.norm(found.sun - told)))
    assert gone[0] < 0.2
    assert gone == sorted(gone)
    assert left == sorted(left, reverse=True)
    assert left[2] < 1.0
    still = climbed(hill(given, told, sun_free=False), pose(), told)
    assert np.array_equal(still.sun, told)


def test_a_told_scale_holds_the_pose():
    given = frame(gain=60.0)
    for sigma in (0.001, 0.1):
        told = PosePrior(float(pose().log_scale[0]) + 0.03, sigma, SUN)
        found = climbed(replace(hill(given), told=told), pose())
        off = float(found.pose.log_scale[0] - told.log_scale)
        assert abs(off) < 0.01 if sigma < 0.01 else off < -0.02


@pytest.mark.parametrize("censored", [True, False])
def test_saturated_pixels_say_at_least_this_and_do_not_move_the_pose(censored):
    """Taken as data, a sensor that ends at half of the light moves the body."""
    clean = frame()
    top = 0.6 * float(clean.image.max())
    full = clean.image >= top
    mask = full if censored else np.zeros_like(full)
    clipped = replace(clean, image=np.minimum(clean.image, top), full=mask)
    assert full.sum() > 60
    found = climbed(hill(clipped), pose(), steps=20)
    error = local(pose(), found.pose)[0]
    squares = error @ np.linalg.solve(found.covariance, error)
    assert squares < 1.0 if censored else squares > 10.0


def test_the_light_of_a_saturated_frame_is_found_in_few_rounds():
    clean = frame()
    top = 0.6 * float(clean.image.max())
    clipped = replace(clean, image=np.minimum(clean.image, top), full=clean.image >= top)
    few, many = (_look(hill(clipped, rounds=rounds), pose(), SUN[None])[1] for rounds in (ROUNDS, 40))
    assert few == pytest.approx(many, abs=20.0)


def test_a_censored_pixel_may_be_brighter_but_not_darker():
    given = frame()
    mask = given.image > 0.7 * given.image.max()
    for factor in (0.3, 1.0, 3.0):
        image = np.where(mask, factor * given.image, given.image).astype(np.float32)
        fits, _ = _look(hill(replace(given, image=image, full=mask)), pose(), SUN[None])
        inside = fits[0].residual[mask]
        assert (inside >= 0).all()
        assert (inside.mean() > 3 * SIGMA) == (factor > 1)


def test_in_squares_of_pixels_places_are_still_those_of_the_frame():
    """A patch of half the resolution: the same pose, in frame pixels."""
    start, view = moved(0.02, -0.02, 0.01, 1.5, -1.0, 0.02, 3.0), replace(VIEW, binning=2.0, side=32)
    given = frame()
    image = given.image.reshape(32, 2, 32, 2).mean(axis=(1, 3))
    core = replace(given.point_spread, core=0.65)
    binned = replace(given, image=image, sigma=SIGMA / 2, full=np.zeros(image.shape, bool), point_spread=core)
    found = climbed(replace(hill(binned), view=view), start)
    error = local(pose(), found.pose)[0]
    assert np.rad2deg(np.linalg.norm(error[:3])) < 1.0
    assert np.abs(error[3:5]).max() < 0.2


def test_a_spread_is_stated_as_if_the_sun_were_unknown_that_frames_have_told():
    """It was learnt from poses that erred as this one does; where it is told, it counts."""
    on = Hill(frame(), lit_body(), VIEW, PosePrior(), quality=QUALITY)
    fits, _ = _look(on, pose(), SUN[None])
    slopes, free = slopes_of(on, pose(), SUN[None], fits), np.zeros((1, 7, 7))
    paint = np.tile(unlearnt(len(fits[0].coefficients)), (1, 1, 1))
    told = [Believed(pose(), free, np.array([True]), paint, SUN[None], np.array([sure])) for sure in (0.0, 1e6)]
    here = np.array([0])
    blind, sure = (systems_of(on, pose(), SUN[None], fits, slopes, one, here) for one in told)
    np.testing.assert_allclose(sure[0][0, 7:, 7:] - blind[0][0, 7:, 7:], 1e6 * np.eye(2), rtol=1e-6, atol=1.0)
    np.testing.assert_array_equal(sure[2], blind[2])

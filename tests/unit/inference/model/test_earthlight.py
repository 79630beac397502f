"""The Earth as a lamp whose direction and strength are told: faces show as much of it as they are painted."""

from dataclasses import replace

import numpy as np
from lit_body import FINEST, QUALITY, SIDE, VIEW, lit_body, pose, scene, shares

from service.inference.light import Light
from service.inference.model.prior import LightPrior, earthlight
from service.inference.model.spread import PointSpread, spread
from service.inference.numerics.gauss_newton import ascend
from service.inference.numerics.hill import Hill, Refined
from service.inference.numerics.priors import PosePrior
from service.inference.pose import angle_between, retract
from service.workers.following import earthlight_of

BEHIND = np.array([0.3, 0.2, 0.93]) / np.linalg.norm([0.3, 0.2, 0.93])  # towards a Sun that lights thin edges
EARTH = earthlight((0.0, 0.0, -1.0), 0.1, 0.3)  # as an observer on it has it: behind the camera
SIGMA, GAIN, PAINT = 2.0, 900.0, (0.4, 2.5, 1.0)


def climbed(told: LightPrior, off_deg: float = 2.0) -> Refined:
    """From a pose that is a little off, on a frame in which the Earth lights what is seen."""
    light = shares(lit_body(), GAIN, albedo=PAINT, even=(0.0, 0.0, 0.0, 0.0))
    drawn = lit_body().combined(pose(), BEHIND, light, replace(VIEW, around=EARTH.around), QUALITY)
    image = spread(drawn, PointSpread(1.3), 0.0)[0] + np.random.default_rng(3).normal(0, SIGMA, (SIDE, SIDE))
    given = scene(image, SIGMA, low_pass=FINEST, light=told, discrepancy=0.01)
    prior = PosePrior(towards_sun=BEHIND, light=told)
    hill = Hill(given, lit_body(), replace(VIEW, around=told.around), prior, QUALITY)
    start = retract(pose(), np.array([[*np.deg2rad([off_deg, -off_deg, off_deg]), 0.5, -0.5, 0.01, off_deg]]))
    return ascend(hill, start, BEHIND[None].copy(), steps=8)[0]


def off_deg(found: Refined) -> float:
    return float(np.rad2deg(angle_between(found.pose.quaternion, pose().quaternion[0]))[0])


def test_what_is_told_of_it_leaves_nothing_over_and_finds_the_pose():
    told, untold = climbed(EARTH), climbed(LightPrior())
    assert told.fit.chi2 < 1 < untold.fit.chi2
    assert told.fit.log_evidence > untold.fit.log_evidence + 100
    assert off_deg(told) < 1 < off_deg(untold)


def test_half_as_much_of_it_is_no_matter():
    told = climbed(earthlight((0.0, 0.0, -1.0), 0.05, 0.3))
    assert told.fit.chi2 < 1 and off_deg(told) < 1


def test_a_face_has_it_by_its_normal():
    told = np.array(earthlight((0.6, 0.0, -0.8), 0.1, 0.3).around)
    for normal, share in (((0.6, 0.0, -0.8), 1.0), ((0.0, 1.0, 0.0), 0.3), ((-0.6, 0.0, 0.8), -0.4)):
        assert np.isclose(told @ [*normal, 1.0], 0.1 * share)


def test_templates_are_drawn_in_all_light_but_the_suns():
    assert EARTH.whole == EARTH.around and LightPrior().whole == (0.0, 0.0, 0.0, LightPrior().even_mean)


def test_it_is_told_by_orbit_and_camera_and_is_more_of_the_light_where_the_sun_sets():
    known = Light((0.0, 0.0, -1.0), 0.02, 1.0, (0.6, 0.0, -0.8), 0.1, 0.3)
    assert earthlight_of(known) == earthlight((0.6, 0.0, -0.8), 0.1, 0.3)
    assert earthlight_of(replace(known, mirrored=True)) == earthlight((0.6, 0.0, 0.8), 0.1, 0.3)
    assert earthlight_of(replace(known, sunlit=0.25)) == earthlight((0.6, 0.0, -0.8), 0.4, 0.3)
    for missing in ({"earth": None}, {"earthshine": None}, {"earthshine": 0.0}):
        assert earthlight_of(replace(known, **missing)) == LightPrior()

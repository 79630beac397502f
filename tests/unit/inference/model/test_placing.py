"""A picture's place in a frame, before anything else of its light is fitted."""

from dataclasses import replace

import numpy as np
import pytest
from lit_body import FINEST, QUALITY, SIDE, SUN, VIEW, lit_body, pose, scene, seen, shares

from service.inference.model.paint import unlearnt
from service.inference.model.scene import Scene
from service.inference.numerics.hill import Hill
from service.inference.numerics.placing import placed
from service.inference.numerics.priors import Believed, PosePrior
from service.inference.pose import concatenate
from service.inference.state import Poses

SIGMA = 4.0
OFF = np.array([[2.6, -1.7]])


def frame(more: np.ndarray | float = 0.0, gain: float = 700.0, **others) -> Scene:
    image = seen(pose(), shares(lit_body(), gain)) + more
    image = image + np.random.default_rng(1).normal(0, SIGMA, image.shape)
    return scene(image, SIGMA, **({"low_pass": FINEST} | others))


def found(given: Scene, starts: Poses, sigma_px: float = 5.0) -> Poses:
    """Of a track whose place is known to ``sigma_px``."""
    hill = Hill(given, lit_body(), VIEW, PosePrior(towards_sun=SUN), quality=QUALITY)
    n = len(starts)
    precision = np.tile(np.diag([1e4] * 3 + [sigma_px**-2] * 2 + [1e4, 1.0]), (n, 1, 1))
    n_planes = hill.drawing.planes(starts[:1], SUN, VIEW, QUALITY).shape[1]
    paint, suns = np.tile(unlearnt(n_planes), (n, 1, 1)), np.tile(SUN, (n, 1))
    return placed(hill, starts, suns, Believed(starts, precision, np.array([True]), paint, suns, np.zeros(n)))


def moved(off: np.ndarray) -> Poses:
    return replace(pose(), position=pose().position + off)


def test_a_body_that_jumped_is_where_its_light_is():
    out = found(frame(), concatenate(moved(OFF), moved(-OFF), pose()))
    np.testing.assert_allclose(out.position, np.repeat(pose().position, 3, 0), atol=0.2)
    np.testing.assert_array_equal(out.quaternion, np.repeat(pose().quaternion, 3, 0))


def test_by_day_a_body_is_where_the_sky_is_hidden():
    """It is darker than the sky, of which it hides more than is expected."""
    drawing, sky = lit_body(), 60.0
    cover = np.zeros(len(shares(drawing, 1.0)), np.float32)
    cover[drawing.n_groups] = 1.0
    day = frame(-0.8 * sky * seen(pose(), cover), gain=15.0, sky=sky)
    assert day.data.min() < -20.0 and day.gain < np.log(sky)
    out = found(day, concatenate(moved(OFF), moved(-OFF), pose()))
    np.testing.assert_allclose(out.position, np.repeat(pose().position, 3, 0), atol=0.5)


def test_what_is_known_of_its_place_counts():
    out = found(frame(), moved(OFF), sigma_px=1e-4)
    np.testing.assert_allclose(out.position, moved(OFF).position, atol=0.01)


@pytest.mark.parametrize("gain", [0.0, -700.0])
def test_where_there_is_no_light_it_stays(gain):
    out = found(frame(gain=gain), moved(OFF), sigma_px=0.5)
    assert np.abs(out.position - moved(OFF).position).max() < 1.0


def test_a_body_that_is_expected_outside_of_the_patch_stays_there():
    away = moved(np.array([[500.0, 0.0]]))
    np.testing.assert_array_equal(found(frame(), away).position, away.position)


def test_a_star_beside_it_does_not_draw_it_away():
    star, pieces = np.zeros((SIDE, SIDE)), np.zeros((SIDE, SIDE), np.uint8)
    star[8:11, 8:11], pieces[7:12, 7:12] = 3e3, 1
    out = found(frame(star, starry=pieces), moved(OFF))
    np.testing.assert_allclose(out.position, pose().position, atol=0.2)


def test_pixels_that_are_full_hold_at_least_so_much():
    image = seen(pose(), shares(lit_body(), 700.0))
    full = image > np.quantile(image, 0.97)
    out = found(frame(np.where(full, image.max() - image - 200.0, 0.0), censored=full), moved(OFF))
    np.testing.assert_allclose(out.position, pose().position, atol=0.3)
